// SPDX-License-Identifier: Apache-2.0
/// @file
/// Files that third-party programs wrote, and the photographs they were made from.

#include <filesystem>
#include <string>
#include <vector>

#include <Eigen/QR>
#include <fmt/format.h>
#include <gtest/gtest.h>

#include "haarlight/core/files.h"
#include "haarlight/core/picture/image_io.h"
#include "haarlight/relight/reflectance/formats/ptm_file.h"
#include "haarlight/relight/reflectance/formats/quantise.h"
#include "haarlight/relight/reflectance/formats/reflectance_file.h"
#include "haarlight/relight/reflectance/formats/rti_file.h"
#include "haarlight/relight/reflectance/formats/web_folder.h"
#include "haarlight/session/light_file.h"
#include "tests/relight/reflectance/formats/quantise_model.h"
#include "tests/relight/reflectance/formats/reflectance_truth.h"
#include "tests/temporary_folder.h"

namespace haarlight::relight {
namespace {

namespace fs = std::filesystem;
using testing::psnr_db;

/// Third-party files; tests skip where they are not.
std::filesystem::path shared_data() {
  return std::filesystem::path(HAARLIGHT_SOURCE_DIR) / "../shared/data";
}

class OthersFiles : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!fs::exists(shared_data() / "formats")) {
      GTEST_SKIP() << "no ../shared/data/formats here";
    }
  }
  static ReflectanceModel flipped(const ReflectanceModel& model) {
    ReflectanceModel turned = model;
    const int h = model.planes.height();
    for (int y = 0; y < h; ++y) {
      const auto from = model.planes.view().row(h - 1 - y);
      std::copy(from.begin(), from.end(), turned.planes.view().row(y).begin());
    }
    return turned;
  }
  /// Mean over the held-out lights (index % 6 == 2) of the capture that the samples are of.
  /// @param y_sign  -1: lit from the mirrored direction, as when rows are taken upside down
  static double held_out_psnr(const ReflectanceModel& model, double y_sign = 1.0) {
    const fs::path folder = shared_data() / "rti_real/item1";
    const session::LightList list = session::read_light_file(folder / "dirs.lp");
    double sum = 0.0;
    int n = 0;
    for (std::size_t i = 2; i < list.lights.size(); i += 6) {
      const PictureFile photo = read_picture(folder / list.lights[i].name);
      const Eigen::Vector3d direction =
          list.lights[i].coordinates.cwiseProduct(Eigen::Vector3d(1.0, y_sign, 1.0));
      sum += psnr_db(relit(model, direction).view(), photo.pixels.view());
      ++n;
    }
    return sum / n;
  }
};

TEST_F(OthersFiles, PtmFittersFileShowsItsPhotographs) {
  const fs::path folder = shared_data() / "formats/ptmfitter";
  const ReflectanceModel model = read_ptm(folder / "reference_8x5.ptm");
  const session::LightList list = session::read_light_file(folder / "reference_8x5.lp");
  ASSERT_EQ(list.lights.size(), 12U);
  for (const session::SessionLight& light : list.lights) {
    const PictureFile photo = read_picture(folder / light.name);
    const double right = psnr_db(relit(model, light.coordinates).view(), photo.pixels.view());
    const double wrong =
        psnr_db(relit(flipped(model), light.coordinates).view(), photo.pixels.view());
    std::printf("%s: %.2f dB, flipped %.2f dB\n", light.name.c_str(), right, wrong);
    EXPECT_GE(right, 48.0) << light.name;
    EXPECT_LT(wrong, 31.0) << light.name;
  }
}

TEST_F(OthersFiles, PtmFittersFileIsWrittenByteForByte) {
  const fs::path file = shared_data() / "formats/ptmfitter/reference_8x5.ptm";
  const testing::TemporaryFolder folder;
  write_ptm(folder / "again.ptm", read_ptm(file));
  EXPECT_EQ(read_file(folder / "again.ptm"), read_file(file));
}

TEST_F(OthersFiles, RelightsHarmonicsAreTopFirst) {
  const ReflectanceModel model =
      read_rti(shared_data() / "formats/relight_hsh9_srgb_487x439.rti");
  const double right = held_out_psnr(model);
  const double wrong = held_out_psnr(flipped(model));
  const double mirrored = held_out_psnr(model, -1.0);
  std::printf("rti: %.2f dB, rows turned %.2f dB, light mirrored %.2f dB\n", right, wrong,
              mirrored);
  EXPECT_NEAR(right, 36.6, 0.1);
  EXPECT_LT(wrong, right - 10.0);
  EXPECT_LT(mirrored, right - 3.0);
}

TEST_F(OthersFiles, EverySampleReads) {
  const fs::path formats = shared_data() / "formats";
  struct Sample {
    const char* name;
    double least_db;
  };
  // The least: what it scores, less a tenth. Whoever wrote BIASCLAMP put a bias of 255 where a
  // larger one belongs: 8 dB lost in the file itself.
  for (const Sample& sample :
       {Sample{"cceh_PTM_FORMAT_LRGB.ptm", 31.5}, Sample{"cceh_PTM_FORMAT_RGB.ptm", 33.3},
        Sample{"cceh_PTM_FORMAT_JPEG_LRGB.ptm", 31.0},
        Sample{"cceh_PTM_FORMAT_JPEG_RGB.ptm", 32.9},
        Sample{"relight_ptm_rgb_srgb_BIASCLAMP_487x439.ptm", 25.0}}) {
    const ReflectanceModel model = read_ptm(formats / sample.name);
    EXPECT_EQ(model.planes.width(), 487);
    EXPECT_EQ(model.planes.height(), 439);
    const double found = held_out_psnr(model);
    std::printf("%s: %.2f dB\n", sample.name, found);
    EXPECT_GE(found, sample.least_db) << sample.name;
  }
  for (const Sample& sample :
       {Sample{"relight_web_ptm", 33.2}, Sample{"relight_web_hsh", 36.4}}) {
    const double found = held_out_psnr(read_web_folder(formats / sample.name));
    std::printf("%s: %.2f dB\n", sample.name, found);
    EXPECT_GE(found, sample.least_db) << sample.name;
  }
}

/// A corner of the capture: photographs and directions.
struct Capture {
  std::vector<Image<float>> photos;
  std::vector<Eigen::Vector3d> directions;
};

Capture read_corner() {
  constexpr int kSide = 160;
  const fs::path folder = shared_data() / "rti_real/item1";
  Capture capture;
  for (const session::SessionLight& light :
       session::read_light_file(folder / "dirs.lp").lights) {
    const PictureFile photo = read_picture(folder / light.name);
    Image<float> corner(kSide, kSide, 3);
    for (int y = 0; y < kSide; ++y) {
      const auto row = photo.pixels.view().row(y + 100).subspan(360, std::size_t{3} * kSide);
      std::copy(row.begin(), row.end(), corner.view().row(y).begin());
    }
    capture.photos.push_back(std::move(corner));
    capture.directions.push_back(light.coordinates);
  }
  return capture;
}

bool is_held_out(std::size_t light) { return light % 6 == 2; }

/// Plain least squares on the lights that are not held out; lrgb: the mean picture's colours,
/// and a luminance that multiplies them.
Image<float> fit_plainly(const ReflectanceModel& shape, const Capture& capture) {
  std::vector<std::size_t> lights;
  for (std::size_t i = 0; i < capture.photos.size(); ++i) {
    if (!is_held_out(i)) {
      lights.push_back(i);
    }
  }
  const auto n = static_cast<Eigen::Index>(lights.size());
  Eigen::MatrixXd terms(n, shape.n_terms);
  for (Eigen::Index i = 0; i < n; ++i) {
    const auto row =
        basis_terms(shape, capture.directions[lights[static_cast<std::size_t>(i)]]);
    terms.row(i) = Eigen::Map<const Eigen::RowVectorXd>(row.data(), shape.n_terms);
  }
  const Eigen::MatrixXd solver =
      terms.colPivHouseholderQr().solve(Eigen::MatrixXd::Identity(n, n));
  const int side = capture.photos[0].height();
  Image<float> coefficients(side, side, n_planes_of(shape.colour, shape.n_terms));
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      Eigen::MatrixX3d values(n, 3);
      for (Eigen::Index i = 0; i < n; ++i) {
        const Image<float>& photo = capture.photos[lights[static_cast<std::size_t>(i)]];
        values.row(i) << photo(y, x, 0), photo(y, x, 1), photo(y, x, 2);
      }
      if (shape.colour == ReflectanceColour::rgb) {
        const Eigen::MatrixX3d fitted = solver * values;
        for (int c = 0; c < 3; ++c) {
          for (int j = 0; j < shape.n_terms; ++j) {
            coefficients(y, x, c * shape.n_terms + j) = static_cast<float>(fitted(j, c));
          }
        }
        continue;
      }
      const Eigen::Vector3d mean = values.colwise().mean().transpose();
      const Eigen::VectorXd luminance =
          solver * (values.rowwise().sum() / std::max(mean.sum(), 1e-3));
      for (int j = 0; j < shape.n_terms; ++j) {
        coefficients(y, x, j) = static_cast<float>(luminance[j]);
      }
      for (int c = 0; c < 3; ++c) {
        coefficients(y, x, shape.n_terms + c) = static_cast<float>(mean[c]);
      }
    }
  }
  return coefficients;
}

template <class Relight>
double mean_held_out(const Capture& capture, const Relight& relight_at) {
  double sum = 0.0;
  int n = 0;
  for (std::size_t i = 0; i < capture.photos.size(); ++i) {
    if (is_held_out(i)) {
      sum += psnr_db(relight_at(capture.directions[i]).view(), capture.photos[i].view());
      ++n;
    }
  }
  return sum / n;
}

/// What a file scores on held-out photographs, against the coefficients before they were bytes.
TEST_F(OthersFiles, BytesCostLessThanAFifthOfADecibel) {
  const Capture capture = read_corner();
  struct Kind {
    const char* name;
    ReflectanceBasis basis;
    ReflectanceColour colour;
    int n_terms;
    bool is_jpeg;
    double most_db;
  };
  for (const Kind& kind :
       {Kind{"rgb.ptm", ReflectanceBasis::ptm, ReflectanceColour::rgb, 6, false, 0.2},
        Kind{"lrgb.ptm", ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6, false, 0.2},
        Kind{"hsh4.rti", ReflectanceBasis::hsh, ReflectanceColour::rgb, 4, false, 0.2},
        Kind{"hsh9.rti", ReflectanceBasis::hsh, ReflectanceColour::rgb, 9, false, 0.2},
        // JPEG at quality 95 is another loss, that of the choice of JPEG.
        Kind{"rgb_jpeg.ptm", ReflectanceBasis::ptm, ReflectanceColour::rgb, 6, true, 1.0},
        Kind{"lrgb_jpeg.ptm", ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6, true, 1.0},
        Kind{"web_rgb", ReflectanceBasis::ptm, ReflectanceColour::rgb, 6, true, 1.0},
        Kind{"web_lrgb", ReflectanceBasis::ptm, ReflectanceColour::lrgb, 6, true, 1.0},
        Kind{"web_hsh9", ReflectanceBasis::hsh, ReflectanceColour::rgb, 9, true, 1.0}}) {
    ReflectanceModel model = testing::empty_model(kind.basis, kind.colour, kind.n_terms);
    const Image<float> coefficients = fit_plainly(model, capture);
    const testing::TemporaryFolder folder;
    quantise(model, coefficients.view(),
             scale_rule(reflectance_format_of_name(folder / kind.name)));
    write_reflectance(folder / kind.name, model, {.is_jpeg = kind.is_jpeg});
    const ReflectanceModel written = read_reflectance(folder / kind.name);
    const double before = mean_held_out(capture, [&](const Eigen::Vector3d& direction) {
      return relit_coefficients(model, coefficients.view(), direction);
    });
    const double after = mean_held_out(
        capture, [&](const Eigen::Vector3d& direction) { return relit(written, direction); });
    std::printf("%-14s %.2f dB, in the file %.2f dB: %.3f dB lost\n", kind.name, before, after,
                before - after);
    EXPECT_LE(before - after, kind.most_db) << kind.name;
  }
}

}  // namespace
}  // namespace haarlight::relight
