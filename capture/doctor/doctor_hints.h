// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "haarlight/core/enum_words.h"
#include "haarlight/core/error.h"

/// @file
/// What the operator can do about a finding: every hint of the doctor, and of the daemon about
/// its devices, as one table of sentences.

namespace haarlight::capture {

enum class HintText {
  // the rig's files and the machine
  measure,
  measure_again,
  use_fine_timers,
  mend_clock_source,
  stop_daemon,
  free_http_port,
  correct_storage,
  permit_storage,
  replace_disk,
  make_room,
  use_faster_disk,
  mount_disk,
  free_space,
  // cameras
  join_group,
  open_camera,
  choose_raw_if_there,
  choose_raw,
  use_monotonic_driver,
  improve_usb,
  write_fps,
  write_exposure,
  unburden_usb,
  plug_in_serial,
  set_device,
  plug_in_camera,
  start_camera_program,
  name_session,
  name_socket,
  end_camera_user,
  start_program_again,
  correct_camera,
  plug_camera_again,
  correct_camera_kind,
  check_trigger,
  check_camera_cable,
  check_camera_power,
  // controllers
  write_unit,
  write_address,
  write_tcp_address,
  write_serial_address,
  plug_in_adapter,
  choose_serial_port,
  join_dialout,
  use_lasting_name,
  use_lasting_path,
  lower_latency,
  check_usb_bus,
  write_serial_number,
  join_plugdev,
  install_udev_rule,
  update_firmware,
  correct_light_count,
  correct_elements,
  connect_measured,
  correct_unit,
  name_profile,
  check_link,
  close_interlock,
  light_fewer,
  end_light_user,
  speed_up_link,
  check_network,
  check_serial_line,
  plug_in_controller,
  correct_controller,
  check_controller_user,
};

/// The sentences; {} stands for a value.
[[nodiscard]] std::span<const std::string_view> words_of(HintText);

/// Nothing, a sentence of the table, or what an Error says itself.
class Hint {
 public:
  Hint() = default;
  /// @param values  one for each {} of the sentence, in their order
  Hint(HintText text,
       const std::vector<std::string>& values = {});  // NOLINT(google-explicit-constructor)
  explicit Hint(const Error& error);

  [[nodiscard]] const std::string& text() const { return text_; }
  [[nodiscard]] bool is_empty() const { return text_.empty(); }

 private:
  std::string text_;
};

}  // namespace haarlight::capture
