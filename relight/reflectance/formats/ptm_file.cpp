// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/reflectance/formats/ptm_file.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <vector>

#include <fmt/format.h>

#include "core/picture/jpeg.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/reflectance/formats/quantise.h"
#include "relight/reflectance/formats/header_reader.h"

namespace haarlight::relight {

namespace {

constexpr int kTerms = 6;
constexpr double kWhite = 255.0;
constexpr std::int64_t kLongestSide = 1 << 20;
/// Values beyond 0..255 are known from writers other than HP's (-217, 271).
constexpr std::int64_t kLargestBias = 1'000'000;
constexpr double kLargestScale = 1e6;

enum class PtmForm { rgb, lrgb, jpeg_rgb, jpeg_lrgb };

bool is_lrgb(PtmForm form) { return form == PtmForm::lrgb || form == PtmForm::jpeg_lrgb; }
bool is_jpeg(PtmForm form) { return form == PtmForm::jpeg_rgb || form == PtmForm::jpeg_lrgb; }

constexpr std::array<std::string_view, 4> kForms{"PTM_FORMAT_RGB", "PTM_FORMAT_LRGB",
                                                 "PTM_FORMAT_JPEG_RGB", "PTM_FORMAT_JPEG_LRGB"};

struct PtmHeader {
  PtmForm form = PtmForm::lrgb;
  bool is_interleaved = false;  ///< lrgb before PTM_1.2: nine bytes per pixel in one block
  int width = 0;
  int height = 0;
  std::array<PlaneScale, kTerms> scales;

  [[nodiscard]] int n_planes() const {
    return n_planes_of(is_lrgb(form) ? ReflectanceColour::lrgb : ReflectanceColour::rgb,
                       kTerms);
  }
};

PtmForm read_form(HeaderReader& reader) {
  const std::string_view word = reader.word();
  const auto* it = std::find(kForms.begin(), kForms.end(), word);
  if (it == kForms.end()) {
    const std::size_t at = reader.offset() - word.size();
    reader.refuse_at(
        at, fmt::format("the form \"{}\" is not read", word),
        "save it as PTM_FORMAT_LRGB or PTM_FORMAT_RGB with the program that made it");
  }
  return static_cast<PtmForm>(it - kForms.begin());
}

PtmHeader read_header(HeaderReader& reader) {
  PtmHeader header;
  const std::string_view version = reader.word();
  if (!is_ptm(version)) {
    reader.refuse_at(0, "not a .ptm: it does not begin with PTM_", "give a .ptm");
  }
  if (version != "PTM_1.2" && version != "PTM_1.1" && version != "PTM_1.0") {
    reader.refuse(fmt::format("\"{}\" is a version that is not known", version));
  }
  header.form = read_form(reader);
  header.is_interleaved = header.form == PtmForm::lrgb && version != "PTM_1.2";
  header.width = static_cast<int>(reader.integer(1, kLongestSide, "width"));
  header.height = static_cast<int>(reader.integer(1, kLongestSide, "height"));
  std::array<double, kTerms> steps{};
  for (double& step : steps) {
    step = reader.number(-kLargestScale, kLargestScale, "scale");
  }
  for (std::size_t j = 0; j < kTerms; ++j) {
    const auto bias = static_cast<double>(reader.integer(-kLargestBias, kLargestBias, "bias"));
    header.scales[j] = {steps[j] / kWhite, -bias * steps[j] / kWhite};
  }
  reader.end_of_header();
  return header;
}

ReflectanceModel make_model(const PtmHeader& header, std::uint64_t most_bytes,
                            const std::string& where) {
  ReflectanceModel model;
  model.basis = ReflectanceBasis::ptm;
  model.colour = is_lrgb(header.form) ? ReflectanceColour::lrgb : ReflectanceColour::rgb;
  model.n_terms = kTerms;
  model.planes =
      allocate_planes(header.height, header.width, header.n_planes(), most_bytes, where);
  model.scales.assign(static_cast<std::size_t>(header.n_planes()), PlaneScale{});
  const std::size_t n_scaled = is_lrgb(header.form) ? kTerms : model.scales.size();
  for (std::size_t p = 0; p < n_scaled; ++p) {
    model.scales[p] = header.scales[p % kTerms];
  }
  return model;
}

/// Some interleaved planes, as in a block of a file.
struct Block {
  int first = 0;
  int n = 0;
};

std::vector<Block> blocks_of(PtmForm form, bool is_interleaved) {
  if (is_interleaved) {
    return {{0, kTerms + 3}};
  }
  if (is_lrgb(form)) {
    return {{0, kTerms}, {kTerms, 3}};
  }
  return {{0, kTerms}, {kTerms, kTerms}, {2 * kTerms, kTerms}};
}

void read_blocks(const PtmHeader& header, std::string_view payload, ReflectanceModel& model) {
  const auto width = static_cast<std::size_t>(header.width);
  const auto n_planes = static_cast<std::size_t>(header.n_planes());
  std::size_t at = 0;
  for (const Block& block : blocks_of(header.form, header.is_interleaved)) {
    const auto first = static_cast<std::size_t>(block.first);
    const auto n = static_cast<std::size_t>(block.n);
    for (int y = header.height - 1; y >= 0; --y) {  // the lowest row comes first
      const auto row = model.planes.view().row(y);
      for (std::size_t x = 0; x < width; ++x) {
        for (std::size_t i = 0; i < n; ++i) {
          row[x * n_planes + first + i] = static_cast<std::uint8_t>(payload[at++]);
        }
      }
    }
  }
}

/// The part between the biases and the pictures of a JPEG form.
struct JpegPart {
  std::vector<std::size_t> sizes;
};

/// One line of the JPEG header that must be as in a file without prediction.
void require_plain(HeaderReader& reader, std::size_t n, std::string_view what,
                   std::int64_t (*expected)(std::size_t plane)) {
  for (std::size_t p = 0; p < n; ++p) {
    const std::int64_t value = reader.integer(-(1 << 30), 1 << 30, what);
    if (value != expected(p)) {
      reader.refuse_at(reader.offset(),
                       fmt::format("plane {} has {} {}: planes coded from one another are not "
                                   "read",
                                   p, what, value),
                       "save it as PTM_FORMAT_LRGB or PTM_FORMAT_RGB with the program that "
                       "made it");
    }
  }
}

JpegPart read_jpeg_header(HeaderReader& reader, std::size_t n) {
  const auto zero = [](std::size_t) -> std::int64_t { return 0; };
  JpegPart part;
  (void)reader.integer(0, 100, "JPEG quality");
  require_plain(reader, n, "transform", zero);
  require_plain(reader, n, "horizontal motion", zero);
  require_plain(reader, n, "vertical motion", zero);
  require_plain(reader, n, "index in the order",
                [](std::size_t p) { return static_cast<std::int64_t>(p); });
  require_plain(reader, n, "reference plane", [](std::size_t) -> std::int64_t { return -1; });
  for (std::size_t p = 0; p < n; ++p) {
    part.sizes.push_back(static_cast<std::size_t>(
        reader.integer(1, std::int64_t{1} << 31, "size of a compressed plane")));
  }
  require_plain(reader, n, "size of side information", zero);
  reader.end_of_header();
  return part;
}

/// @return  the pictures, each with its offset within the payload
std::vector<std::string_view> split_payload(const JpegPart& part, const HeaderReader& reader) {
  std::vector<std::string_view> pictures;
  std::size_t at = 0;
  for (const std::size_t size : part.sizes) {
    const std::string_view payload = reader.rest();
    if (payload.size() - at < size) {
      reader.refuse_at(reader.offset() + at,
                       fmt::format("plane {} ends after {} of its {} bytes", pictures.size(),
                                   payload.size() - at, size),
                       "copy the file again from its source");
    }
    pictures.push_back(payload.substr(at, size));
    at += size;
  }
  if (at != reader.rest().size()) {
    reader.refuse_at(reader.offset() + at,
                     fmt::format("{} bytes too many", reader.rest().size() - at),
                     "copy the file again from its source");
  }
  return pictures;
}

ReflectanceModel read_jpeg_planes(const PtmHeader& header, HeaderReader& reader,
                                  std::uint64_t most_bytes, const std::string& where) {
  const auto n_planes = static_cast<std::size_t>(header.n_planes());
  const JpegPart part = read_jpeg_header(reader, n_planes);
  const std::vector<std::string_view> pictures = split_payload(part, reader);
  const auto position = [&](std::size_t p) {
    const auto at = static_cast<std::size_t>(pictures[p].data() - reader.rest().data());
    return fmt::format("{}, plane {}", location_in_file(where, reader.offset() + at), p);
  };
  for (std::size_t p = 0; p < n_planes; ++p) {  // before anything large is allocated
    const JpegShape shape = jpeg_shape(pictures[p], position(p));
    if (shape.width != header.width || shape.height != header.height) {
      throw Error(fmt::format("a picture of {} x {} in a file of {} x {}", shape.width,
                              shape.height, header.width, header.height),
                  position(p), "make the file again with its program");
    }
  }
  ReflectanceModel model = make_model(header, most_bytes, where);
  for (std::size_t p = 0; p < n_planes; ++p) {
    decode_jpeg(pictures[p], 1, position(p), [&](int y, std::span<const std::uint8_t> samples) {
      const auto row = model.planes.view().row(header.height - 1 - y);
      for (std::size_t x = 0; x < samples.size(); ++x) {
        row[x * n_planes + p] = samples[x];
      }
    });
  }
  return model;
}

void require_writable(const std::filesystem::path& path, const ReflectanceModel& model) {
  const std::string where = path.string();
  require_consistent(model, where);
  if (model.basis != ReflectanceBasis::ptm || model.colour == ReflectanceColour::pca) {
    throw Error(fmt::format("a .ptm cannot hold {}", to_string(model.basis)), where,
                "fit it as ptm first: haarlight convert does");
  }
  if (model.transfer != Transfer::srgb) {
    throw Error("viewers show a .ptm as sRGB, and these colours are not", where,
                "fit it to sRGB first: haarlight convert does");
  }
  HAARLIGHT_EXPECTS(obeys(ScaleRule::ptm, model), "scales that a .ptm can say");
}

std::string header_text(const ReflectanceModel& model, PtmForm form) {
  std::string scales;
  std::string biases;
  for (std::size_t j = 0; j < kTerms; ++j) {
    const PtmScale term = ptm_scale(model.scales[j]);
    scales += fmt::format("{:.6f} ", term.scale);
    biases += fmt::format("{} ", term.bias);
  }
  return fmt::format("PTM_1.2\n{}\n{}\n{}\n{}\n{}\n", kForms[static_cast<std::size_t>(form)],
                     model.planes.width(), model.planes.height(), scales, biases);
}

std::span<const std::byte> bytes_of(std::string_view text) {
  return std::as_bytes(std::span(text.data(), text.size()));
}

void write_blocks(PendingFile& file, const ReflectanceModel& model, PtmForm form) {
  const auto n_planes = static_cast<std::size_t>(model.n_planes());
  const auto width = static_cast<std::size_t>(model.planes.width());
  std::vector<std::uint8_t> line;
  for (const Block& block : blocks_of(form, false)) {
    const auto first = static_cast<std::size_t>(block.first);
    const auto n = static_cast<std::size_t>(block.n);
    line.resize(width * n);
    for (int y = model.planes.height() - 1; y >= 0; --y) {
      const auto row = model.planes.view().row(y);
      for (std::size_t x = 0; x < width; ++x) {
        std::copy_n(&row[x * n_planes + first], n, &line[x * n]);
      }
      file.append(std::as_bytes(std::span(line)));
    }
  }
}

void write_jpegs(PendingFile& file, const ReflectanceModel& model, const PtmOptions& options,
                 const std::string& where) {
  const auto n_planes = static_cast<std::size_t>(model.n_planes());
  const JpegShape shape{model.planes.height(), model.planes.width()};
  std::vector<std::string> pictures;
  std::string order;
  std::string references;
  std::string sizes;
  std::string zeros;
  for (std::size_t p = 0; p < n_planes; ++p) {
    pictures.push_back(
        encode_jpeg(shape, JpegQuality{.channels = 1, .quality = options.quality}, where,
                    [&](int y, std::span<std::uint8_t> samples) {
                      const auto row = model.planes.view().row(shape.height - 1 - y);
                      for (std::size_t x = 0; x < samples.size(); ++x) {
                        samples[x] = row[x * n_planes + p];
                      }
                    }));
    order += fmt::format("{} ", p);
    references += "-1 ";
    sizes += fmt::format("{} ", pictures.back().size());
    zeros += "0 ";
  }
  file.append(bytes_of(fmt::format("{}\n{}\n{}\n{}\n{}\n{}\n{}\n{}\n", options.quality, zeros,
                                   zeros, zeros, order, references, sizes, zeros)));
  for (const std::string& picture : pictures) {
    file.append(bytes_of(picture));
  }
}

}  // namespace

bool is_ptm(std::string_view head) noexcept { return head.substr(0, 4) == "PTM_"; }

ReflectanceModel parse_ptm(std::string_view bytes, const std::string& where,
                           std::uint64_t most_bytes) {
  HeaderReader reader(bytes, where);
  const PtmHeader header = read_header(reader);
  if (is_jpeg(header.form)) {
    return read_jpeg_planes(header, reader, most_bytes, where);
  }
  const std::string_view payload = reader.rest();
  const std::uint64_t expected = static_cast<std::uint64_t>(header.width) *
                                 static_cast<std::uint64_t>(header.height) *
                                 static_cast<std::uint64_t>(header.n_planes());
  if (payload.size() != expected) {
    reader.refuse_at(
        reader.offset() + std::min<std::uint64_t>(payload.size(), expected),
        fmt::format("{} bytes of pixels, where {} x {} x {} are {}", payload.size(),
                    header.width, header.height, header.n_planes(), expected),
        "copy the file again from its source");
  }
  ReflectanceModel model = make_model(header, most_bytes, where);
  read_blocks(header, payload, model);
  return model;
}

ReflectanceModel read_ptm(const std::filesystem::path& path, std::uint64_t most_bytes) {
  const MappedFile file(path);
  const auto bytes = file.bytes();
  return parse_ptm({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, path.string(),
                   most_bytes);
}

void write_ptm(const std::filesystem::path& path, const ReflectanceModel& model,
               const PtmOptions& options) {
  require_writable(path, model);
  const bool has_luminance = model.colour == ReflectanceColour::lrgb;
  const PtmForm form = options.is_jpeg
                           ? (has_luminance ? PtmForm::jpeg_lrgb : PtmForm::jpeg_rgb)
                           : (has_luminance ? PtmForm::lrgb : PtmForm::rgb);
  PendingFile file(path);
  file.append(bytes_of(header_text(model, form)));
  if (options.is_jpeg) {
    write_jpegs(file, model, options, path.string());
  } else {
    write_blocks(file, model, form);
  }
  file.commit();
}

}  // namespace haarlight::relight
