// SPDX-License-Identifier: Apache-2.0
#include "relight/pipeline/fit/fit_output.h"

#include "core/temporary_folder.h"
#include "haarlight/core/error.h"
#include "relight/pipeline/bytes_on_disk.h"

namespace haarlight::relight {

namespace {

namespace fs = std::filesystem;

WebFiles code_folder(const ReflectanceModel& model, const FitSize& size,
                     const MeasurePictures& measure, const std::string& where) {
  if (size.bytes) {
    return code_to_bytes(model, *size.bytes, where);
  }
  if (size.psnr_db) {
    return code_to_psnr(model, *size.psnr_db, measure, where);
  }
  return code_web_folder(model, {.quality = size.quality.value_or(kWebQuality)}, where);
}

}  // namespace

void require_one_size(const FitSize& size, std::optional<ReflectanceFormat> format) {
  const int n = (size.quality ? 1 : 0) + (size.bytes ? 1 : 0) + (size.psnr_db ? 1 : 0);
  if (n > 1) {
    throw Error("--quality, --bytes and --psnr each decide the others", "the options",
                "give one of them", ExitCode::usage);
  }
  if (n == 1 && format != ReflectanceFormat::web) {
    throw Error("only a folder's pictures have a quality", "--quality, --bytes, --psnr",
                "write a folder (a name without an ending), or leave the option out",
                ExitCode::usage);
  }
}

FitFile write_fit(const fs::path& path, ReflectanceModel& model, const FitSize& size,
                  const MeasurePictures& measure, bool keeps_planes) {
  const ReflectanceFormat format = reflectance_format_of_name(path);
  FitFile file;
  if (format == ReflectanceFormat::web) {
    const WebFiles files = code_folder(model, size, measure, path.string());
    write_web_files(path, files);
    file.name = "folder";
    file.quality = files.quality;
    file.bytes = files.bytes();
  } else {
    write_reflectance(path, model);
    file.name = to_string(format);
    file.bytes = bytes_on_disk(path);
  }
  if (!keeps_planes) {
    model.planes = {};
  }
  file.psnr_db = measure(read_reflectance(path, {.most_bytes = ~std::uint64_t{0}}));
  return file;
}

std::optional<FitFile> try_fit_file(ReflectanceModel& model, const MeasurePictures& measure,
                                    bool keeps_planes) {
  const TemporaryFolder folder;
  if (can_hold(ReflectanceFormat::web, model)) {
    return write_fit(folder.path() / "web", model, {}, measure, keeps_planes);
  }
  if (can_hold(ReflectanceFormat::rti, model)) {
    return write_fit(folder.path() / "fit.rti", model, {}, measure, keeps_planes);
  }
  return {};
}

}  // namespace haarlight::relight
