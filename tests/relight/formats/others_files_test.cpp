/// @file
/// Files that other people's programs wrote, and the photographs they were made from.

#include <filesystem>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "core/files.h"
#include "core/image_io.h"
#include "relight/formats/ptm_file.h"
#include "relight/formats/rti_file.h"
#include "relight/formats/web_folder.h"
#include "session/light_file.h"
#include "tests/relight/formats/reflectance_truth.h"
#include "tests/temporary_folder.h"

namespace haarlight {
namespace {

namespace fs = std::filesystem;
using testing::psnr_db;
using testing::shared_data;

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
    const LightList list = read_light_file(folder / "dirs.lp");
    double sum = 0.0;
    int n = 0;
    for (std::size_t i = 2; i < list.lights.size(); i += 6) {
      const PictureFile photo = read_picture(folder / list.lights[i].name);
      const Eigen::Vector3d direction =
          list.lights[i].place.cwiseProduct(Eigen::Vector3d(1.0, y_sign, 1.0));
      sum += psnr_db(relit(model, direction).view(), photo.pixels.view());
      ++n;
    }
    return sum / n;
  }
};

TEST_F(OthersFiles, PtmFittersFileShowsItsPhotographs) {
  const fs::path folder = shared_data() / "formats/ptmfitter";
  const ReflectanceModel model = read_ptm(folder / "reference_8x5.ptm");
  const LightList list = read_light_file(folder / "reference_8x5.lp");
  ASSERT_EQ(list.lights.size(), 12U);
  for (const SessionLight& light : list.lights) {
    const PictureFile photo = read_picture(folder / light.name);
    const double right = psnr_db(relit(model, light.place).view(), photo.pixels.view());
    const double wrong =
        psnr_db(relit(flipped(model), light.place).view(), photo.pixels.view());
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
  EXPECT_LT(mirrored, right - 10.0);
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

}  // namespace
}  // namespace haarlight
