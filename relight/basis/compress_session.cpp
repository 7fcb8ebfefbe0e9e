// SPDX-License-Identifier: Apache-2.0
#include "haarlight/relight/basis/compress_session.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "haarlight/relight/basis/haar.h"
#include "haarlight/session/develop/develop.h"
#include "relight/basis/coder/integer_coding.h"
#include "relight/basis/compress_plate.h"
#include "relight/basis/light_basis.h"
#include "relight/basis/plate/planes_plate.h"
#include "session/develop/sensor_response.h"

namespace haarlight::relight {

namespace {

/// A row of lights has neighbours too; a single light has none.
bool is_worth_a_wavelet(const HaarGrid& grid) { return grid.is_valid() && grid.size() > 1; }

HaarGrid rig_grid(const Rig& rig) {
  if (rig.faces.empty()) {
    return {};
  }
  const HaarGrid grid{rig.faces.front().rows, rig.faces.front().cols};
  const bool are_alike = std::all_of(rig.faces.begin(), rig.faces.end(), [&](const Face& face) {
    return face.rows == grid.rows && face.cols == grid.cols;
  });
  return are_alike && is_worth_a_wavelet(grid) ? grid : HaarGrid{};
}

constexpr int kBandRows = 64;  // of a frame's strip

/// A session's rows, developed from its frames on demand.
class DevelopedRows final : public RowSource {
 public:
  DevelopedRows(const session::Session& session, const session::DevelopOptions& options)
      : developer_(session, options) {}

  [[nodiscard]] const std::string& key() const noexcept { return developer_.key(); }
  [[nodiscard]] std::vector<double> steps() const { return developer_.steps(); }
  [[nodiscard]] StackDims dims() const override { return developer_.dims(); }
  /// As many as a frame stores together, where they fit: to keep more in memory costs more than
  /// to make them again, unless it is a mosaic's colours.
  [[nodiscard]] int rows_at_once() const override {
    const StackBands bands = developer_.bands();
    const bool is_kept = bands.rows >= bands.height && dims().channels > 1;
    return is_kept ? bands.height : std::min(bands.rows, kBandRows);
  }
  void finish() override { static_cast<void>(developer_.record()); }
  [[nodiscard]] bool tells_clipped() const override { return true; }

  void load_rows(int y0, int y1) override {
    if (y0 >= y0_ && y1 <= y1_) {
      return;
    }
    y0_ = y1_ = 0;  // until they are there
    rows_ = developer_.rows(y0, y1, std::move(rows_));
    y0_ = y0;
    y1_ = y1;
  }

  void read_tile(const TileRect& rect, std::span<float> out) const override {
    cut(std::span<const float>(rows_.values), rect, out.data());
  }

  [[nodiscard]] std::vector<std::uint8_t> clipped_in(const TileRect& rect) const override {
    if (rows_.clipped.empty()) {
      return {};
    }
    const StackDims all = dims();
    std::vector<std::uint8_t> out(static_cast<std::size_t>(rect.n_pixels()) *
                                  static_cast<std::size_t>(all.channels) *
                                  static_cast<std::size_t>(all.n_lights));
    cut(std::span<const std::uint8_t>(rows_.clipped), rect, out.data());
    return out;
  }

 private:
  /// A tile of the developed rows' per-value data.
  template <class T>
  void cut(std::span<const T> from, const TileRect& rect, T* to) const {
    HAARLIGHT_EXPECTS(rect.y0 >= y0_ && rect.y0 + rect.height <= y1_, "rows that are loaded");
    const StackDims all = dims();
    const auto n_lights = static_cast<std::size_t>(all.n_lights);
    const auto width = static_cast<std::size_t>(all.width);
    const std::size_t n = static_cast<std::size_t>(rect.width) * n_lights;
    for (int c = 0; c < all.channels; ++c) {
      for (int y = rect.y0; y < rect.y0 + rect.height; ++y) {
        const std::size_t line = static_cast<std::size_t>(c * (y1_ - y0_) + y - y0_) * width +
                                 static_cast<std::size_t>(rect.x0);
        to = std::copy_n(from.data() + line * n_lights, n, to);
      }
    }
  }

  session::Developer developer_;
  session::Developer::Rows rows_;  ///< (channels, y1_ - y0_, width, n_lights)
  int y0_ = 0;
  int y1_ = 0;
};

OpenPlate open_plate(const session::Session& session, const StackDims& dims,
                     const PlateChoice& choice, const CompressOptions& options) {
  return open_plate(session.rig() ? &*session.rig() : nullptr, dims, choice,
                    {options.memory_bytes, options.progress, options.unknown_as});
}

}  // namespace

HaarGrid haar_grid(const session::SessionInfo& info) {
  const HaarGrid grid{info.grid_rows, info.grid_cols};
  const auto n_lights = static_cast<int>(info.lights.size());
  return is_worth_a_wavelet(grid) && n_lights % grid.size() == 0 ? grid : HaarGrid{};
}

session::PlatePixels sharing_plate(const session::Session& session, const PlateChoice& choice) {
  const session::SessionInfo& info = session.info();
  const PatternFamily family = info.patterns.family;
  if (family != PatternFamily::bins && family != PatternFamily::haar &&
      family != PatternFamily::target) {
    return {};
  }
  const StackDims dims{info.form.width, info.form.height, 1,
                       static_cast<int>(info.lights.size())};
  CompressOptions options;
  options.memory_bytes = 0;  // read once: no copy in memory
  const auto plate =
      std::make_shared<const OpenPlate>(open_plate(session, dims, choice, options));
  if (plate->source == nullptr) {
    return {};
  }
  const StackDims found = plate->source->dims();
  if (found.width != dims.width || found.height != dims.height ||
      found.n_lights != dims.n_lights || found.channels != 1) {
    throw Error(
        fmt::format("a clean plate of {} x {} x {} under {} lights for frames of {} x {} under "
                    "{}: it must be grey and fit",
                    found.width, found.height, found.channels, found.n_lights, dims.width,
                    dims.height, dims.n_lights),
        choice.path.string(), "make the clean plate from this session's rig");
  }
  session::PlatePixels pixels;
  pixels.key =
      fmt::format("{} {} {}", to_string(plate->origin), plate->hash, choice.path.string());
  pixels.read = [plate](int y, int x0, int x1, std::span<float> out) {
    plate->source->read_tile({x0, y, x1 - x0, 1}, out);
    for (float& value : out) {
      value = std::max(value, 0.0F);  // a captured plate's noise
    }
  };
  return pixels;
}

std::optional<double> measure_noise(const session::Session& session, const PlateChoice& choice,
                                    const CompressOptions& options) {
  constexpr int kRows = 16;
  if (!session::sensor_response(session).is_measured) {
    return std::nullopt;
  }
  session::DevelopOptions develop_options;
  develop_options.memory_bytes = options.memory_bytes;
  develop_options.unknown_as = options.unknown_as;
  develop_options.plate = sharing_plate(session, choice);
  develop_options.has_standard_error = true;
  session::Developer developer(session, develop_options);
  const int height = developer.dims().height;
  const int n_rows = std::min(height, kRows);
  Progress progress("look at the noise", static_cast<std::size_t>(n_rows), options.progress);
  double energy = 0.0;
  double noise = 0.0;
  session::Developer::Rows rows;
  for (int i = 0; i < n_rows; ++i) {
    const int y =
        static_cast<int>((2 * std::int64_t{i} + 1) * height / (std::int64_t{2} * n_rows));
    rows = developer.rows(y, y + 1, std::move(rows));
    for (std::size_t k = 0; k < rows.values.size(); ++k) {
      const double error = std::max(0.0F, rows.errors[k]);  // -1: clipped
      noise += error * error;
      energy += double{rows.values[k]} * double{rows.values[k]};
    }
    progress.advance();
  }
  return energy > 0.0 ? std::optional(std::sqrt(noise / energy)) : std::nullopt;
}

namespace {

/// Where the floats are exactly whole camera steps, storing those is smaller. Nothing where any
/// value is not.
std::optional<CompressSummary> compress_whole_steps(const CompressSource& source,
                                                    const std::filesystem::path& file,
                                                    CompressOptions options) {
  constexpr int kRows = 4;
  const StackDims dims = source.stack->dims();
  const auto n_lights = static_cast<std::size_t>(dims.n_lights);
  std::vector<float> row(static_cast<std::size_t>(dims.width * dims.channels) * n_lights);
  for (int i = 0; i < kRows; ++i) {
    const int y =
        static_cast<int>((2 * std::int64_t{i} + 1) * dims.height / (std::int64_t{2} * kRows));
    source.rows->load_rows(y, y + 1);
    source.stack->read_tile({0, y, dims.width, 1}, row);
    for (std::size_t at = 0; at < row.size(); ++at) {
      const double unit = source.units[at % n_lights];
      const double whole = std::round(double{row[at]} / unit);
      if (std::abs(whole) > kLargestInteger || static_cast<float>(whole * unit) != row[at]) {
        return std::nullopt;
      }
    }
  }
  // Under a temporary name until the other rows are known to be exact, too.
  std::filesystem::path whole = file;
  whole += ".whole";
  options.is_integer = true;
  CompressSummary summary = compress_stack(source, whole, options);
  const bool is_exact = summary.header.achieved.worst_value == 0.0;
  if (options.rank.i == 0) {
    if (is_exact) {
      std::filesystem::rename(whole, file);
    } else {
      std::filesystem::remove(whole);
    }
  }
  options.rank.wait_for_all();
  return is_exact ? std::optional(std::move(summary)) : std::nullopt;
}

}  // namespace

CompressSummary compress_session(const session::Session& session, const PlateChoice& choice,
                                 const std::filesystem::path& file,
                                 const CompressOptions& options) {
  session::DevelopOptions develop_options;
  develop_options.marks_clipped = true;
  develop_options.memory_bytes = options.memory_bytes / 2;
  develop_options.unknown_as = options.unknown_as;
  develop_options.plate = sharing_plate(session, choice);
  DevelopedRows rows(session, develop_options);
  const OpenPlate plate = open_plate(session, rows.dims(), choice, options);
  CompressOptions rest = options;
  rest.memory_bytes -= develop_options.memory_bytes;
  CompressSource source;
  source.stack = &rows;
  source.rows = &rows;
  source.plate = plate.source.get();
  source.plate_origin = plate.origin;
  source.plate_source = plate.hash;
  source.key =
      content_hash(rows.key() + "\n" + std::string(to_string(plate.origin)) + "\n" + plate.key);
  source.grid = haar_grid(session.info());
  source.units = rows.steps();
  // The rig describes the lights only if the session has all of them.
  if (session.rig() && session.rig()->n_lights() == rows.dims().n_lights) {
    source.rig_toml = session.rig()->text;
    source.rig_hash = session.rig()->hash;
  }
  for (const session::SessionLight& light : session.info().lights) {
    if (source.rig_toml.empty()) {
      source.lights.push_back(
          {light.name, light.is_position, light.coordinates, light.relative_power});
    }
  }
  source.location = session.folder().string();
  source.name = session.info().id.empty() ? source.location : session.info().id;
  source.hash = session.info().plan_hash;
  source.root = session.info().root;
  source.photographed = session.info().photographed;
  if (rest.relative_l2 == 0.0 && !rest.is_integer && !source.units.empty() &&
      is_integer_basis(rest.basis)) {
    if (std::optional<CompressSummary> whole = compress_whole_steps(source, file, rest)) {
      return *std::move(whole);
    }
  }
  return compress_stack(source, file, rest);
}

CompressSummary compress_plate(const Rig& rig, const std::filesystem::path& file,
                               const CompressOptions& options) {
  const std::unique_ptr<StackSource> computed = make_rig_plate(rig);
  CompressOptions rest = options;
  CompressSource source;
  source.stack = computed.get();
  source.plate = source.stack;
  source.plate_origin = PlateOrigin::computed;
  source.plate_source = rig.hash;
  source.grid = rig_grid(rig);
  source.rig_toml = rig.text;
  source.rig_hash = rig.hash;
  source.name = rig.name;
  source.location = "rig " + rig.name;
  source.hash = rig.hash;
  source.content = BasisContent::plate;
  source.key = rig.hash;
  if (source.grid.size() == 0) {
    rest.basis = BasisKind::direct;
  }
  if (const auto* plane = dynamic_cast<const ComputedPlate*>(computed.get())) {
    if (auto summary = compress_smooth_plate(*plane, source, file, rest)) {
      return *std::move(summary);
    }
  }
  // Two passes read the plate; in memory where half the budget holds it.
  std::optional<MemoryStack> memory;
  const StackDims dims = computed->dims();
  const std::uint64_t bytes = std::uint64_t{dims.n_pixels()} *
                              static_cast<std::uint64_t>(dims.n_lights) * sizeof(float);
  if (bytes <= options.memory_bytes / 2) {
    memory = read_all(*computed, bytes);
    rest.memory_bytes -= bytes;
    source.stack = &*memory;
    source.plate = source.stack;
  }
  return compress_stack(source, file, rest);
}

}  // namespace haarlight::relight
