// SPDX-License-Identifier: Apache-2.0
#include "capture/doctor/rig_doctor.h"

#include <chrono>
#include <thread>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "capture/camera/remote_camera_protocol.h"
#include "core/rig/measured_rig.h"
#include "haarlight/core/error.h"
#include "haarlight/core/files.h"
#include "sim/virtual_rig.h"
#include "tests/sim/made_transport.h"
#include "tests/temporary_folder.h"

namespace haarlight::capture {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using testing::TemporaryFolder;

void put(const fs::path& file, const std::string& text) {
  fs::create_directories(file.parent_path());
  write_file_atomically(file, text);
}

/// Ends as a sentence does, in no quotation, parenthesis or command that it began.
bool is_whole_sentence(const std::string& text) {
  if (text.empty() || text.front() == ' ' || text.find("  ") != std::string::npos ||
      std::string(".?").find(text.back()) == std::string::npos) {
    return false;
  }
  std::string open;
  for (const char c : text) {
    const bool closes = !open.empty() && open.back() == c;
    if (closes) {
      open.pop_back();
    } else if (c == '(' || c == '[' || c == '{') {
      open.push_back(c == '(' ? ')' : c == '[' ? ']' : '}');
    } else if (c == '"' || c == '`') {
      open.push_back(c);
    } else if (c == ')' || c == ']' || c == '}') {
      return false;
    }
  }
  return open.empty();
}

const DoctorLine& line_of(const std::vector<DoctorLine>& lines, const std::string& subject) {
  static const DoctorLine kNone{"no such line", Finding::wrong, "", ""};
  for (const DoctorLine& line : lines) {
    EXPECT_EQ(line.hint.is_empty(), line.finding == Finding::good) << line.subject;
    EXPECT_TRUE(line.hint.is_empty() || is_whole_sentence(line.hint.text()))
        << line.hint.text();
    if (line.subject == subject) {
      return line;
    }
  }
  ADD_FAILURE() << "no line about " << subject;
  return kNone;
}

class Doctor : public ::testing::Test {
 protected:
  Doctor()
      : rig_(read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml")),
        controller_(server_options(rig_)) {
    rig_.controller.address = controller_.tcp_address();
    options_.root = folder_.path();
    options_.other_ports.clear();
    options_.disk_test_bytes = 1U << 20U;
  }

  static sim::ControllerServerOptions server_options(const Rig& rig) {
    sim::ControllerServerOptions options;
    options.controller = firmware_iface::controller_config(rig);
    options.unit = 3;
    options.has_rtu = true;
    options.baud = 0;
    return options;
  }

  [[nodiscard]] int port() const {
    const std::string address = controller_.tcp_address();
    return std::stoi(address.substr(address.rfind(':') + 1));
  }

  TemporaryFolder folder_;
  Rig rig_;
  sim::ControllerServer controller_;
  DoctorOptions options_;
};

/// Every sentence of the table, and a line's hint is nothing else (Hint's constructors): all
/// that the doctor and the daemon can say.
TEST(DoctorHints, AreWholeSentences) {
  for (const HintText hint : all_values<HintText>()) {
    const std::string text(to_string(hint));
    EXPECT_TRUE(is_whole_sentence(text)) << text;
    // Cut after any word it is none, unless a sentence of it ends there.
    for (std::size_t at = text.find(' '); at != std::string::npos;
         at = text.find(' ', at + 1)) {
      const std::string cut = text.substr(0, at);
      EXPECT_EQ(is_whole_sentence(cut), cut.back() == '?') << cut;
    }
  }
}

TEST(DoctorHints, TakeAValueForEveryGap) {
  EXPECT_EQ(Hint(HintText::write_address, {"10.0.0.7", "1502"}).text(),
            "write address = \"10.0.0.7:1502\": a light controller answers there.");
  EXPECT_THROW(Hint(HintText::write_address, {"10.0.0.7"}), ContractViolation);
  EXPECT_THROW(Hint(HintText::write_address, {"10.0.0.7", "1502", "3"}), ContractViolation);
  EXPECT_EQ(Hint(Error("what", "where", "do this")).text(), "do this.");
  EXPECT_EQ(Hint(Error("what", "where", "is it on?")).text(), "is it on?");
}

TEST_F(Doctor, FindsTheRightController) {
  rig_.controller.unit = 3;
  const auto lines = examine_controller(rig_, options_);
  EXPECT_TRUE(is_healthy(lines));
  EXPECT_THAT(line_of(lines, "controller").found, HasSubstr("64 elements"));
  EXPECT_THAT(line_of(lines, "controller state").found, HasSubstr("dark"));
}

TEST_F(Doctor, FindsTheUnitThatAnswers) {
  rig_.controller.unit = 1;
  const auto lines = examine_controller(rig_, options_);
  EXPECT_EQ(line_of(lines, "controller").finding, Finding::wrong);
  EXPECT_THAT(line_of(lines, "controller").hint.text(), HasSubstr("write unit = 3"));
}

TEST_F(Doctor, FindsThePortThatAnswers) {
  rig_.controller.unit = 3;
  rig_.controller.address = "127.0.0.1:1";
  options_.other_ports = {2, port()};
  const auto lines = examine_controller(rig_, options_);
  EXPECT_EQ(line_of(lines, "controller").finding, Finding::wrong);
  EXPECT_THAT(line_of(lines, "controller").hint.text(),
              HasSubstr(fmt::format("write address = \"127.0.0.1:{}\"", port())));
  options_.other_ports = {2};
  EXPECT_THAT(line_of(examine_controller(rig_, options_), "controller").hint.text(),
              HasSubstr("switched on"));
  rig_.controller.address = "nowhere";
  EXPECT_FALSE(is_healthy(examine_controller(rig_, options_)));
}

TEST_F(Doctor, SaysWhenTheElementsAreOthers) {
  rig_.controller.unit = 3;
  rig_.faces[0].rows = 4;
  const auto lines = examine_controller(rig_, options_);
  EXPECT_THAT(line_of(lines, "controller").hint.text(), HasSubstr("describes 32 lights"));
}

TEST_F(Doctor, SaysWhenItIsNotTheControllerThatWasMeasured) {
  rig_.controller.unit = 3;
  MeasuredRig measured;
  measured.controller = MeasuredController{};
  measured.controller->identity = "haarlight-sim, serial 77";
  rig_.measured = std::make_shared<const MeasuredRig>(measured);
  const auto lines = examine_controller(rig_, options_);
  EXPECT_THAT(line_of(lines, "controller").found, HasSubstr("measured was"));
}

TEST_F(Doctor, NamesAnOpenInterlockAndALitArray) {
  rig_.controller.unit = 3;
  controller_.set_interlock_open(true);
  EXPECT_THAT(line_of(examine_controller(rig_, options_), "controller state").hint.text(),
              HasSubstr("close the interlock"));
}

TEST_F(Doctor, ReadsTheSerialLine) {
  rig_.controller.kind = ControllerKind::modbus_rtu;
  rig_.controller.unit = 3;
  rig_.controller.address = controller_.rtu_address();
  const fs::path tty = fs::canonical(controller_.rtu_path());
  auto lines = examine_controller(rig_, options_);
  EXPECT_TRUE(is_healthy(lines));
  const fs::path timer =
      folder_ / ("sys/bus/usb-serial/devices/" + tty.filename().string() + "/latency_timer");
  fs::create_directories(folder_ / "dev/serial/by-id");
  fs::create_symlink("../../" + tty.filename().string(),
                     folder_ / "dev/serial/by-id/usb-FTDI_A50285BI-if00-port0");
  put(timer, "16\n");
  lines = examine_controller(rig_, options_);
  EXPECT_TRUE(is_healthy(lines));
  EXPECT_EQ(line_of(lines, "latency timer").finding, Finding::warning);
  EXPECT_THAT(line_of(lines, "latency timer").hint.text(), HasSubstr("tee"));
  EXPECT_EQ(line_of(lines, "serial line").finding, Finding::warning);
  EXPECT_THAT(line_of(lines, "serial line").hint.text(),
              HasSubstr("/dev/serial/by-id/usb-FTDI_A50285BI-if00-port0"));
  put(timer, "1\n");
  EXPECT_EQ(line_of(examine_controller(rig_, options_), "latency timer").finding,
            Finding::good);
  // Unplugged: what is there instead is offered.
  controller_.unplug_rtu();
  rig_.controller.address = "/dev/serial/by-id/usb-gone:115200";
  lines = examine_controller(rig_, options_);
  EXPECT_EQ(line_of(lines, "serial line").finding, Finding::wrong);
  EXPECT_THAT(line_of(lines, "serial line").hint.text(),
              HasSubstr("usb-FTDI_A50285BI-if00-port0"));
}

TEST_F(Doctor, ListsControllersOnUsb) {
  rig_.controller.kind = ControllerKind::usb;
  rig_.controller.address = "HL0042";
  std::vector<firmware_iface::UsbController> there;
  options_.list_usb = [&there] {
    return Result<std::vector<firmware_iface::UsbController>>(there);
  };
  EXPECT_THAT(line_of(examine_controller(rig_, options_), "USB").hint.text(),
              HasSubstr("plug it in"));
  there.push_back({"HL0043", "cube", 0x1209, 1, "bus 1 port 2", ""});
  DoctorLine line = line_of(examine_controller(rig_, options_), "USB");
  EXPECT_THAT(line.found, HasSubstr("HL0043 (bus 1 port 2)"));
  EXPECT_THAT(line.hint.text(), HasSubstr("serial number"));
  rig_.controller.address = "HL0043";
  EXPECT_EQ(line_of(examine_controller(rig_, options_), "USB").finding, Finding::good);
  // It may not be opened, so that its serial number is not known; and no rule is installed.
  there = {{"", "", 0x1209, 1, "bus 1 port 2", "no permission"}};
  line = line_of(examine_controller(rig_, options_), "USB");
  EXPECT_EQ(line.finding, Finding::wrong);
  EXPECT_THAT(line.found, HasSubstr("no permission"));
  EXPECT_THAT(line.hint.text(), HasSubstr("install 99-haarlight.rules"));
  put(folder_ / "etc/udev/rules.d/99-haarlight.rules", "");
  EXPECT_THAT(line_of(examine_controller(rig_, options_), "USB").hint.text(),
              HasSubstr("plugdev"));
  options_.list_usb = [] {
    return Result<std::vector<firmware_iface::UsbController>>(
        fail(Errc::unsupported, "USB: none"));
  };
  EXPECT_THAT(line_of(examine_controller(rig_, options_), "USB").found, HasSubstr("USB: none"));
}

TEST_F(Doctor, ChecksTheClock) {
  const fs::path source =
      folder_ / "sys/devices/system/clocksource/clocksource0/current_clocksource";
  put(source, "tsc\n");
  EXPECT_EQ(examine_clock(options_).at(0).finding, Finding::good);
  put(source, "hpet\n");
  EXPECT_EQ(examine_clock(options_).at(0).finding, Finding::warning);
}

TEST_F(Doctor, TellsADaemonFromAnotherProgram) {
  bool is_held = true;
  EXPECT_EQ(examine_daemon(rig_, options_, is_held).at(0).finding, Finding::good);
  EXPECT_FALSE(is_held);
  options_.fetch = [](const std::string&) { return std::string("{\"phase\": \"idle\"}"); };
  EXPECT_EQ(examine_daemon(rig_, options_, is_held).at(0).finding, Finding::warning);
  EXPECT_TRUE(is_held);
  options_.fetch = [](const std::string&) { return std::string("<html>printer</html>"); };
  EXPECT_EQ(examine_daemon(rig_, options_, is_held).at(0).finding, Finding::wrong);
  EXPECT_FALSE(is_held);
}

TEST_F(Doctor, ChecksTheDisk) {
  rig_.storage.folder = (folder_ / "sessions/not/yet/made").string();
  EXPECT_EQ(examine_storage(rig_, options_).at(0).finding, Finding::good);
  EXPECT_TRUE(fs::is_empty(folder_.path())) << "nothing is left behind";
  rig_.storage.reserve_mb = 1e9;
  EXPECT_EQ(examine_storage(rig_, options_).at(0).finding, Finding::wrong);
  rig_.storage.folder = "/dev/null/sessions";
  EXPECT_THAT(examine_storage(rig_, options_).at(0).hint.text(), HasSubstr("storage.folder"));
}

TEST_F(Doctor, SaysWhichMeasuredValuesAreUsed) {
  const fs::path file = folder_ / "r.toml";
  write_file_atomically(file, rig_.text);
  EXPECT_EQ(examine_measured(file).at(0).finding, Finding::warning);
  MeasuredRig measured;
  measured.date = "2026-11-21T11:00:00Z";
  measured.tool = "test";
  measured.controller = MeasuredController{};
  measured.controller->with = describe_controller(rig_.controller);
  measured.controller->latch_us = Measured{812.0, 20.0, 100};
  // As a version wrote it that measured the mean alone.
  write_file_atomically(folder_ / "r.measured.toml", to_toml(measured));
  EXPECT_EQ(examine_measured(file).at(0).finding, Finding::warning);
  EXPECT_THAT(examine_measured(file).at(0).found, HasSubstr("no latch_most_us"));
  EXPECT_THAT(examine_measured(file).at(0).hint.text(), HasSubstr("haarlight rig commission"));
  measured.controller->latch_most_us = Measured{812.0, 20.0, 100};
  write_file_atomically(folder_ / "r.measured.toml", to_toml(measured));
  EXPECT_EQ(examine_measured(file).at(0).finding, Finding::good);
  EXPECT_THAT(examine_measured(file).at(0).found, HasSubstr("latch 812 us"));
  measured.controller->with = "something else";
  write_file_atomically(folder_ / "r.measured.toml", to_toml(measured));
  EXPECT_EQ(examine_measured(file).at(0).finding, Finding::wrong);
}

/// The server needs a moment to notice that its last client has left.
DoctorLine examine_when_free(const Rig& rig, const DoctorOptions& options) {
  for (int attempt = 0;; ++attempt) {
    DoctorLine line = examine_camera(rig, 0, options).at(0);
    if (attempt == 100 || line.hint.text().find("another program") == std::string::npos) {
      return line;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
}

TEST(DoctorCamera, ExaminesAServedCamera) {
  const TemporaryFolder folder;
  Rig rig = read_rig(HAARLIGHT_SOURCE_DIR "/configs/rigs/small8.toml");
  std::vector<sim::Transport> transports;
  transports.push_back(testing::flat_transport(folder, 64, 48, std::vector<float>(64, 1.0F)));
  sim::VirtualRigOptions options;
  options.own_folder = folder.path();
  options.doubtful_us = 0.0;
  const sim::VirtualRig served(rig, transports, options);
  const Rig& addressed = served.rig();
  DoctorOptions doctor;
  doctor.camera_frames = 12;
  auto line = examine_when_free(addressed, doctor);
  EXPECT_NE(line.finding, Finding::wrong) << line.found;
  EXPECT_THAT(line.found, HasSubstr("64 x 56"));

  Rig other = addressed;
  other.cameras[0].frame_width = 32;
  line = examine_when_free(other, doctor);
  EXPECT_EQ(line.finding, Finding::wrong);
  EXPECT_THAT(line.hint.text(), HasSubstr("size"));

  other = addressed;
  other.cameras[0].fps = 480.0;
  line = examine_when_free(other, doctor);
  EXPECT_EQ(line.finding, Finding::warning);
  EXPECT_THAT(line.hint.text(), HasSubstr("write fps"));

  other = addressed;
  MeasuredRig measured;
  measured.cameras.emplace_back();
  measured.cameras[0].id = "main";
  measured.cameras[0].identity = "another camera";
  other.measured = std::make_shared<const MeasuredRig>(measured);
  line = examine_when_free(other, doctor);
  EXPECT_EQ(line.finding, Finding::wrong);
  EXPECT_THAT(line.found, HasSubstr("stale"));

  other = addressed;
  other.cameras[0].device = (folder / "gone.sock").string();
  line = examine_when_free(other, doctor);
  EXPECT_EQ(line.finding, Finding::wrong);
  EXPECT_THAT(line.hint.text(), HasSubstr("start the camera's program"));
  write_file_atomically(folder / "file", std::string_view("x"));
  other.cameras[0].device = (folder / "file").string();
  EXPECT_THAT(examine_camera(other, 0, doctor).at(0).found, HasSubstr("no socket"));
}

}  // namespace
}  // namespace haarlight::capture
