// SPDX-License-Identifier: Apache-2.0
#include "firmware_iface/usb_link.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

#include <fmt/format.h>
#include <libusb.h>

#include "firmware_iface/usb_frame.h"

namespace haarlight::firmware_iface {

namespace {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;
using Bytes = std::vector<std::uint8_t>;

constexpr milliseconds kGrace{300};  // beyond a deadline, for the scheduler of a loaded machine
constexpr milliseconds kClosing{1000};
constexpr milliseconds kEventSlice{1000};
constexpr unsigned kStringMs = 250;
constexpr std::size_t kMostLeftBehind = 3;
constexpr std::uint16_t kEnglish = 0x0409;
constexpr std::size_t kReceiveBytes = 1024;  // a whole number of packets of any size
constexpr const char* kNoPermission =
    "no permission: install configs/udev/99-haarlight.rules, see docs/reference/controllers.md";

struct ListFree {
  void operator()(libusb_device** list) const noexcept { libusb_free_device_list(list, 1); }
};
struct ConfigFree {
  void operator()(libusb_config_descriptor* c) const noexcept {
    libusb_free_config_descriptor(c);
  }
};
struct HandleClose {
  void operator()(libusb_device_handle* h) const noexcept { libusb_close(h); }
};
struct TransferFree {
  void operator()(libusb_transfer* t) const noexcept { libusb_free_transfer(t); }
};
using HandlePtr = std::unique_ptr<libusb_device_handle, HandleClose>;

/// Where a light controller's registers are.
struct Endpoints {
  int interface = 0;
  std::uint8_t out = 0;
  std::uint8_t in = 0;
  std::size_t max_packet = 0;
};

std::optional<Endpoints> endpoints_of(libusb_device* device) {
  libusb_config_descriptor* raw = nullptr;
  if (libusb_get_config_descriptor(device, 0, &raw) != 0) {
    return std::nullopt;
  }
  const std::unique_ptr<libusb_config_descriptor, ConfigFree> config(raw);
  for (int i = 0; i < config->bNumInterfaces; ++i) {
    const libusb_interface& interface = config->interface[i];
    if (interface.num_altsetting < 1) {
      continue;
    }
    const libusb_interface_descriptor& d = interface.altsetting[0];
    if (d.bInterfaceClass != usb::kInterfaceClass ||
        d.bInterfaceSubClass != usb::kInterfaceSubclass ||
        d.bInterfaceProtocol != usb::kInterfaceProtocol) {
      continue;
    }
    Endpoints found{.interface = d.bInterfaceNumber};
    for (int k = 0; k < d.bNumEndpoints; ++k) {
      const libusb_endpoint_descriptor& e = d.endpoint[k];
      if ((e.bmAttributes & LIBUSB_TRANSFER_TYPE_MASK) != LIBUSB_TRANSFER_TYPE_BULK) {
        continue;
      }
      if ((e.bEndpointAddress & LIBUSB_ENDPOINT_IN) != 0) {
        found.in = e.bEndpointAddress;
      } else {
        found.out = e.bEndpointAddress;
        found.max_packet = e.wMaxPacketSize;
      }
    }
    if (found.in != 0 && found.out != 0 && found.max_packet != 0) {
      return found;
    }
  }
  return std::nullopt;
}

std::string read_string(libusb_device_handle* handle, std::uint8_t index) {
  std::array<std::uint8_t, 255> bytes{};
  if (index == 0) {
    return {};
  }
  const int n =
      libusb_control_transfer(handle, LIBUSB_ENDPOINT_IN, LIBUSB_REQUEST_GET_DESCRIPTOR,
                              static_cast<std::uint16_t>((LIBUSB_DT_STRING << 8U) | index),
                              kEnglish, bytes.data(), bytes.size(), kStringMs);
  std::string text;
  for (int i = 2; i + 1 < std::min<int>(n, bytes[0]); i += 2) {
    const auto at = static_cast<std::size_t>(i);
    const bool is_plain = bytes[at + 1] == 0 && bytes[at] >= 0x20 && bytes[at] < 0x7F;
    text += is_plain ? static_cast<char>(bytes[at]) : '?';
  }
  return text;
}

std::string position_of(libusb_device* device) {
  std::array<std::uint8_t, 8> ports{};
  const int n = libusb_get_port_numbers(device, ports.data(), static_cast<int>(ports.size()));
  std::string location = fmt::format("bus {}", libusb_get_bus_number(device));
  for (int i = 0; i < n; ++i) {
    location +=
        fmt::format("{}{}", i == 0 ? " port " : ".", ports[static_cast<std::size_t>(i)]);
  }
  return location;
}

/// One device that has a controller's interface.
struct Found {
  UsbController controller;
  Endpoints endpoints;
  HandlePtr handle;
};

/// Opens each of them in turn; stops after the one with this serial number (empty: none).
Result<std::vector<Found>> find_controllers(libusb_context* context,
                                            const std::string& serial) {
  libusb_device** raw = nullptr;
  const ssize_t n = libusb_get_device_list(context, &raw);
  if (n < 0) {
    return fail(Errc::io, fmt::format("listing the USB devices: {}",
                                      libusb_error_name(static_cast<int>(n))));
  }
  const std::unique_ptr<libusb_device*, ListFree> list(raw);
  std::vector<Found> all;
  for (ssize_t i = 0; i < n; ++i) {
    const auto endpoints = endpoints_of(raw[i]);
    libusb_device_descriptor d{};
    if (!endpoints || libusb_get_device_descriptor(raw[i], &d) != 0) {
      continue;
    }
    Found& found = all.emplace_back();
    found.endpoints = *endpoints;
    found.controller.vendor_id = d.idVendor;
    found.controller.product_id = d.idProduct;
    found.controller.location = position_of(raw[i]);
    libusb_device_handle* handle = nullptr;
    const int opened = libusb_open(raw[i], &handle);
    if (opened != 0) {
      found.controller.problem =
          opened == LIBUSB_ERROR_ACCESS ? kNoPermission : libusb_strerror(opened);
      continue;
    }
    found.handle.reset(handle);
    found.controller.serial = read_string(handle, d.iSerialNumber);
    found.controller.product = read_string(handle, d.iProduct);
    if (found.controller.serial.empty()) {
      found.controller.problem = "its serial number cannot be read";
    }
    if (!serial.empty() && found.controller.serial == serial) {
      break;
    }
  }
  return all;
}

Errc code_of_error(int error) {
  switch (error) {
    case LIBUSB_ERROR_NO_DEVICE:
    case LIBUSB_ERROR_NOT_FOUND:
      return Errc::device_gone;
    case LIBUSB_ERROR_BUSY:
    case LIBUSB_ERROR_ACCESS:
      return Errc::device_busy;
    case LIBUSB_ERROR_TIMEOUT:
      return Errc::timeout;
    case LIBUSB_ERROR_PIPE:
    case LIBUSB_ERROR_OVERFLOW:
      return Errc::protocol;
    default:
      return Errc::io;
  }
}

/// The libusb error corresponding to a transfer's status.
int error_of(libusb_transfer_status status) {
  switch (status) {
    case LIBUSB_TRANSFER_COMPLETED:
      return 0;
    case LIBUSB_TRANSFER_TIMED_OUT:
    case LIBUSB_TRANSFER_CANCELLED:
      return LIBUSB_ERROR_TIMEOUT;
    case LIBUSB_TRANSFER_STALL:
      return LIBUSB_ERROR_PIPE;
    case LIBUSB_TRANSFER_NO_DEVICE:
      return LIBUSB_ERROR_NO_DEVICE;
    case LIBUSB_TRANSFER_OVERFLOW:
      return LIBUSB_ERROR_OVERFLOW;
    case LIBUSB_TRANSFER_ERROR:
      break;
  }
  return LIBUSB_ERROR_IO;
}

std::string describe(int error) {
  switch (error) {
    case LIBUSB_ERROR_PIPE:
      return "the device stalled";
    case LIBUSB_ERROR_TIMEOUT:
      return "no answer";
    case LIBUSB_ERROR_NO_DEVICE:
      return "the device left the bus";
    case LIBUSB_ERROR_BUSY:
      return "another program uses the device";
    default:
      return libusb_strerror(error);
  }
}

/// A transfer, or an OUT and the subsequent IN transfers.
struct Job {
  enum class Step { control, out, in };
  Step step = Step::control;
  Bytes out;  ///< with libusb's SETUP packet in front for a control transfer
  Bytes in;
  std::function<UsbVerdict(std::span<const std::uint8_t>)> classify;
  Clock::time_point deadline;
  // Written once by the USB thread, with `is_done` under the engine's lock.
  bool is_done = false;
  int error = 0;
  bool is_broken = false;
  Bytes answer;
};

}  // namespace

/// The thread that talks to libusb, and its state.
class UsbEngine : public std::enable_shared_from_this<UsbEngine> {
 public:
  UsbEngine() = default;
  ~UsbEngine() = default;
  UsbEngine(const UsbEngine&) = delete;
  UsbEngine& operator=(const UsbEngine&) = delete;

  void start() {
    thread_ = std::thread([self = shared_from_this()] { self->run(); });
  }

  /// Runs `act` on the USB thread. Nothing: it did not return in time.
  template <class T>
  std::optional<T> call(std::function<T(UsbEngine&)> act, milliseconds limit) {
    auto result = std::make_shared<std::optional<T>>();
    post([this, act = std::move(act), result] {
      T value = act(*this);
      const std::lock_guard lock(mutex_);
      *result = std::move(value);
      changed_.notify_all();
    });
    std::unique_lock lock(mutex_);
    if (!changed_.wait_for(lock, limit + kGrace, [&] { return result->has_value(); })) {
      is_hung_ = true;
      return std::nullopt;
    }
    return std::move(*result);
  }

  /// Runs a job to completion. False: the USB thread hangs.
  bool perform(const std::shared_ptr<Job>& job) {
    post([this, job] { begin(job); });
    std::unique_lock lock(mutex_);
    const bool is_done =
        changed_.wait_until(lock, job->deadline + kGrace, [&] { return job->is_done; });
    is_hung_ = is_hung_ || !is_done;
    return is_done;
  }

  /// Cancels, closes and joins. False: the thread is still busy and was left behind.
  bool stop() {
    {
      const std::lock_guard lock(mutex_);
      is_stopping_ = true;
      interrupt();
    }
    std::unique_lock lock(mutex_);
    const bool is_over = changed_.wait_for(lock, kClosing, [this] { return is_over_; });
    lock.unlock();
    if (is_over) {
      thread_.join();
    } else {
      thread_.detach();  // it holds a reference to this engine
    }
    return is_over;
  }

  [[nodiscard]] bool is_over() {
    const std::lock_guard lock(mutex_);
    return is_over_;
  }
  [[nodiscard]] bool is_gone() const { return is_gone_; }
  [[nodiscard]] bool is_hung() {
    const std::lock_guard lock(mutex_);
    return is_hung_;
  }
  [[nodiscard]] const Endpoints& endpoints() const { return endpoints_; }

  // ---- on the USB thread ----

  Result<void> open(const std::string& serial, UsbUse use) {
    if (context_ == nullptr) {
      return fail(Errc::unsupported, fmt::format("USB: {}", libusb_strerror(init_error_)));
    }
    auto all = find_controllers(context_, serial);
    if (!all) {
      return tl::unexpected<Fault>(all.error());
    }
    const auto it = std::find_if(all->begin(), all->end(), [&serial](const Found& found) {
      return found.controller.serial == serial && found.handle;
    });
    if (it == all->end()) {
      return not_found(*all);
    }
    if (use == UsbUse::claimed) {
      const int claimed = libusb_claim_interface(it->handle.get(), it->endpoints.interface);
      if (claimed != 0) {
        return fail(code_of_error(claimed),
                    fmt::format("claiming its interface: {}", describe(claimed)));
      }
      is_claimed_ = true;
    }
    endpoints_ = it->endpoints;
    handle_ = std::move(it->handle);
    transfer_.reset(libusb_alloc_transfer(0));
    // Where the platform does not report departures, transfers detect them.
    has_watch_ = libusb_hotplug_register_callback(
                     context_, LIBUSB_HOTPLUG_EVENT_DEVICE_LEFT, 0, LIBUSB_HOTPLUG_MATCH_ANY,
                     LIBUSB_HOTPLUG_MATCH_ANY, LIBUSB_HOTPLUG_MATCH_ANY, &UsbEngine::on_left,
                     this, &watch_) == LIBUSB_SUCCESS;
    return {};
  }

  Result<std::vector<UsbController>> list() {
    if (context_ == nullptr) {
      return fail(Errc::unsupported, fmt::format("USB: {}", libusb_strerror(init_error_)));
    }
    auto all = find_controllers(context_, "");
    if (!all) {
      return tl::unexpected<Fault>(all.error());
    }
    std::vector<UsbController> controllers;
    for (Found& found : *all) {
      controllers.push_back(std::move(found.controller));
    }
    return controllers;
  }

  Result<void> clear_halts() {
    for (const std::uint8_t endpoint : {endpoints_.out, endpoints_.in}) {
      const int cleared = libusb_clear_halt(handle_.get(), endpoint);
      if (cleared != 0) {
        return fail(code_of_error(cleared),
                    fmt::format("clearing the stall: {}", describe(cleared)));
      }
    }
    return {};
  }

 private:
  static tl::unexpected<Fault> not_found(const std::vector<Found>& all) {
    std::string there;
    bool is_barred = false;
    for (const Found& found : all) {
      const UsbController& c = found.controller;
      there += fmt::format("{}{} ({}{}{})", there.empty() ? "" : ", ",
                           c.serial.empty() ? "one without serial number" : c.serial,
                           c.location, c.problem.empty() ? "" : ": ", c.problem);
      is_barred = is_barred || !found.handle;
    }
    return fail(
        is_barred ? Errc::device_busy : Errc::device_gone,
        there.empty() ? "no light controller on USB" : "not on USB; there are: " + there);
  }

  void post(std::function<void()> task) {
    const std::lock_guard lock(mutex_);
    tasks_.push_back(std::move(task));
    interrupt();
  }

  /// Wakes the USB thread. mutex_ is held: the context lives.
  void interrupt() {
    if (wakeable_ != nullptr) {
      libusb_interrupt_event_handler(wakeable_);
    }
  }

  void run() {
    try {
      init_error_ = libusb_init(&context_);
      if (init_error_ != 0) {
        context_ = nullptr;
      }
      {
        const std::lock_guard lock(mutex_);
        wakeable_ = context_;
      }
      while (run_tasks()) {
        handle_events(kEventSlice);
      }
      shut();
    } catch (...) {  // out of memory: cannot continue here
      is_gone_ = true;
    }
    const std::lock_guard lock(mutex_);
    is_over_ = true;
    changed_.notify_all();
  }

  /// False when stopping.
  bool run_tasks() {
    std::deque<std::function<void()>> tasks;
    {
      std::unique_lock lock(mutex_);
      if (context_ == nullptr) {  // no events to wait for
        changed_.wait(lock, [this] { return is_stopping_ || !tasks_.empty(); });
      }
      tasks.swap(tasks_);
    }
    for (const auto& task : tasks) {
      task();
    }
    return !is_stopping();
  }

  void handle_events(milliseconds limit) {
    if (context_ == nullptr) {
      return;
    }
    timeval slice{limit.count() / 1000, (limit.count() % 1000) * 1000};
    const int handled = libusb_handle_events_timeout_completed(context_, &slice, nullptr);
    if (handled != 0 && handled != LIBUSB_ERROR_INTERRUPTED) {
      is_gone_ = true;
      std::this_thread::sleep_for(milliseconds(10));  // do not spin on the error
    }
  }

  void shut() {
    if (job_) {
      libusb_cancel_transfer(transfer_.get());
      const auto give_up = Clock::now() + kClosing / 2;
      while (job_ && Clock::now() < give_up) {
        handle_events(milliseconds(20));
      }
    }
    {
      const std::lock_guard lock(mutex_);
      wakeable_ = nullptr;
    }
    if (job_) {
      // The kernel does not return the transfer: its memory, the handle and the context must
      // outlive it.
      immortal_ = shared_from_this();
      return;
    }
    transfer_.reset();
    if (handle_ && is_claimed_) {
      libusb_release_interface(handle_.get(), endpoints_.interface);
    }
    if (has_watch_) {
      libusb_hotplug_deregister_callback(context_, watch_);
    }
    handle_.reset();
    if (context_ != nullptr) {
      libusb_exit(context_);
      context_ = nullptr;
    }
  }

  // ---- transfers ----

  void begin(const std::shared_ptr<Job>& job) {
    if (job_ || !handle_) {
      finish(job, LIBUSB_ERROR_BUSY, false);
      return;
    }
    job_ = job;
    submit();
  }

  void submit() {
    const auto left = std::chrono::ceil<milliseconds>(job_->deadline - Clock::now()).count();
    if (left <= 0) {
      finish(std::exchange(job_, nullptr), LIBUSB_ERROR_TIMEOUT, false);
      return;
    }
    const auto timeout = static_cast<unsigned>(left);
    libusb_transfer* t = transfer_.get();
    switch (job_->step) {
      case Job::Step::control:
        libusb_fill_control_transfer(t, handle_.get(), job_->out.data(), &UsbEngine::on_done,
                                     this, timeout);
        break;
      case Job::Step::out:
        libusb_fill_bulk_transfer(t, handle_.get(), endpoints_.out, job_->out.data(),
                                  static_cast<int>(job_->out.size()), &UsbEngine::on_done, this,
                                  timeout);
        break;
      case Job::Step::in:
        job_->in.resize(kReceiveBytes);
        libusb_fill_bulk_transfer(t, handle_.get(), endpoints_.in, job_->in.data(),
                                  static_cast<int>(job_->in.size()), &UsbEngine::on_done, this,
                                  timeout);
        break;
    }
    const int submitted = libusb_submit_transfer(t);
    if (submitted != 0) {
      finish(std::exchange(job_, nullptr), submitted, false);
    }
  }

  void finish(const std::shared_ptr<Job>& job, int error, bool is_broken) {
    if (error == LIBUSB_ERROR_NO_DEVICE) {
      is_gone_ = true;
    }
    const std::lock_guard lock(mutex_);
    job->error = error;
    job->is_broken = is_broken;
    job->is_done = true;
    changed_.notify_all();
  }

  static void LIBUSB_CALL on_done(libusb_transfer* transfer) {
    static_cast<UsbEngine*>(transfer->user_data)->completed(*transfer);
  }

  void completed(const libusb_transfer& transfer) {
    const int error = error_of(transfer.status);
    if (error != 0 || is_stopping()) {
      finish(std::exchange(job_, nullptr), error != 0 ? error : LIBUSB_ERROR_TIMEOUT, false);
      return;
    }
    const auto n = static_cast<std::size_t>(std::max(transfer.actual_length, 0));
    switch (job_->step) {
      case Job::Step::control:
        job_->answer.assign(
            job_->out.begin() + LIBUSB_CONTROL_SETUP_SIZE,
            job_->out.begin() + static_cast<std::ptrdiff_t>(LIBUSB_CONTROL_SETUP_SIZE + n));
        finish(std::exchange(job_, nullptr), 0, false);
        return;
      case Job::Step::out:
        job_->step = Job::Step::in;
        submit();
        return;
      case Job::Step::in:
        break;
    }
    const std::span<const std::uint8_t> got(job_->in.data(), n);
    switch (n == 0 ? UsbVerdict::older : job_->classify(got)) {
      case UsbVerdict::mine:
        job_->answer.assign(got.begin(), got.end());
        finish(std::exchange(job_, nullptr), 0, false);
        return;
      case UsbVerdict::older:
        submit();
        return;
      case UsbVerdict::broken:
        finish(std::exchange(job_, nullptr), 0, true);
        return;
    }
  }

  [[nodiscard]] bool is_stopping() {
    const std::lock_guard lock(mutex_);
    return is_stopping_;
  }

  /// Only records it: closing here would wait for the very thread that calls.
  static int LIBUSB_CALL on_left(libusb_context* /*context*/, libusb_device* device,
                                 libusb_hotplug_event /*event*/, void* self) {
    auto& engine = *static_cast<UsbEngine*>(self);
    if (engine.handle_ && libusb_get_device(engine.handle_.get()) == device) {
      engine.is_gone_ = true;
    }
    return 0;
  }

  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<std::function<void()>> tasks_;
  bool is_stopping_ = false;
  bool is_over_ = false;
  bool is_hung_ = false;
  libusb_context* wakeable_ = nullptr;
  std::atomic<bool> is_gone_{false};
  std::thread thread_;
  // Used by the USB thread only; endpoints_ is settled before open() returns.
  libusb_context* context_ = nullptr;
  int init_error_ = 0;
  HandlePtr handle_;
  Endpoints endpoints_;
  bool is_claimed_ = false;
  bool has_watch_ = false;
  libusb_hotplug_callback_handle watch_ = 0;
  std::unique_ptr<libusb_transfer, TransferFree> transfer_;
  std::shared_ptr<Job> job_;  ///< in flight
  std::shared_ptr<UsbEngine> immortal_;
};

Result<std::vector<UsbController>> list_usb_controllers(milliseconds limit) {
  using Listing = Result<std::vector<UsbController>>;
  auto engine = std::make_shared<UsbEngine>();
  engine->start();
  auto listing = engine->call<Listing>([](UsbEngine& e) { return e.list(); }, limit);
  engine->stop();
  if (!listing) {
    return fail(Errc::timeout, "listing the USB devices: no answer from the system");
  }
  return std::move(*listing);
}

// ---- the link ----

namespace {

tl::unexpected<Fault> hung(const char* operation) {
  return fail(Errc::timeout,
              fmt::format("{}: a USB call of the system does not return", operation));
}

/// The result of a job that returned.
Result<Bytes> outcome(Job& job) {
  if (job.error != 0) {
    return fail(code_of_error(job.error), describe(job.error));
  }
  if (job.is_broken) {
    return fail(Errc::protocol, "an answer that is none");
  }
  return std::move(job.answer);
}

/// A vendor request's transfer: SETUP packet and space for its data.
std::shared_ptr<Job> control_job(std::uint8_t type, std::uint8_t request, std::size_t n_bytes,
                                 milliseconds limit) {
  auto job = std::make_shared<Job>();
  job->out.resize(LIBUSB_CONTROL_SETUP_SIZE + n_bytes);
  libusb_fill_control_setup(job->out.data(), type, request, 0, 0,
                            static_cast<std::uint16_t>(n_bytes));
  job->deadline = Clock::now() + limit;
  return job;
}

}  // namespace

UsbLink::UsbLink() = default;
UsbLink::~UsbLink() { close(); }

Result<void> UsbLink::open(const std::string& serial, UsbUse use, milliseconds limit) {
  close();
  left_behind_.erase(std::remove_if(left_behind_.begin(), left_behind_.end(),
                                    [](const auto& engine) { return engine->is_over(); }),
                     left_behind_.end());
  if (left_behind_.size() >= kMostLeftBehind) {
    return fail(Errc::device_busy,
                fmt::format("{} USB calls of the system have not returned: pull the cable, or "
                            "restart the machine",
                            left_behind_.size()));
  }
  engine_ = std::make_shared<UsbEngine>();
  engine_->start();
  auto opened = engine_->call<Result<void>>(
      [serial, use](UsbEngine& engine) { return engine.open(serial, use); }, limit);
  if (!opened) {
    close();
    return hung("opening");
  }
  if (!*opened) {
    close();
  }
  return std::move(*opened);
}

void UsbLink::close() noexcept {
  if (engine_ && !engine_->stop()) {
    left_behind_.push_back(engine_);
  }
  engine_.reset();
}

bool UsbLink::is_open() const noexcept { return engine_ != nullptr; }
bool UsbLink::is_lost() const noexcept {
  return engine_ && (engine_->is_gone() || engine_->is_hung());
}
std::size_t UsbLink::max_packet() const noexcept {
  return engine_ ? engine_->endpoints().max_packet : 0;
}

Result<Bytes> UsbLink::exchange(
    std::span<const std::uint8_t> out,
    std::function<UsbVerdict(std::span<const std::uint8_t>)> classify, milliseconds limit) {
  HAARLIGHT_EXPECTS(engine_ != nullptr, "an open link");
  auto job = std::make_shared<Job>();
  job->step = Job::Step::out;
  job->out.assign(out.begin(), out.end());
  job->classify = std::move(classify);
  job->deadline = Clock::now() + limit;
  if (!engine_->perform(job)) {
    return hung("sending a request");
  }
  return outcome(*job);
}

Result<Bytes> UsbLink::control_in(std::uint8_t request, std::size_t n_bytes,
                                  milliseconds limit) {
  HAARLIGHT_EXPECTS(engine_ != nullptr, "an open link");
  const auto job = control_job(usb::kVendorIn, request, n_bytes, limit);
  if (!engine_->perform(job)) {
    return hung("a control request");
  }
  return outcome(*job);
}

Result<void> UsbLink::control_out(std::uint8_t request, milliseconds limit) {
  HAARLIGHT_EXPECTS(engine_ != nullptr, "an open link");
  const auto job = control_job(usb::kVendorOut, request, 0, limit);
  if (!engine_->perform(job)) {
    return hung("a control request");
  }
  const auto answer = outcome(*job);
  return answer ? Result<void>() : tl::unexpected<Fault>(answer.error());
}

Result<void> UsbLink::clear_halts(milliseconds limit) {
  HAARLIGHT_EXPECTS(engine_ != nullptr, "an open link");
  auto cleared = engine_->call<Result<void>>(
      [](UsbEngine& engine) { return engine.clear_halts(); }, limit);
  return cleared ? std::move(*cleared) : hung("clearing a stall");
}

}  // namespace haarlight::firmware_iface
