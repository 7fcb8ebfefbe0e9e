// SPDX-License-Identifier: Apache-2.0
#include "tests/firmware_iface/usb_testbed.h"

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <list>
#include <mutex>
#include <stdexcept>
#include <vector>

#include <dlfcn.h>
#include <fmt/format.h>
#include <linux/usbdevice_fs.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <umockdev.h>
#include <unistd.h>

// ThreadSanitizer does not see the futexes of GLib's own locks, nor libudev's and umockdev's
// code: what it reports inside them is not ours. libusb's locks are pthread's, which it sees.
// NOLINTNEXTLINE(bugprone-reserved-identifier,cert-dcl37-c,cert-dcl51-cpp,readability-identifier-naming)
extern "C" const char* __tsan_default_suppressions() {
  return "race:libglib-2.0.so\nrace:libgio-2.0.so\nrace:libgobject-2.0.so\n"
         "race:libumockdev\nrace:libudev.so\n";
}

// Nor do we answer for what umockdev and GLib keep until the process ends.
// NOLINTNEXTLINE(bugprone-reserved-identifier,cert-dcl37-c,cert-dcl51-cpp,readability-identifier-naming)
extern "C" const char* __lsan_default_suppressions() {
  return "leak:libglib-2.0.so\nleak:libgio-2.0.so\nleak:libgobject-2.0.so\n"
         "leak:libumockdev\nleak:libudev.so\n";
}

// The kernel's netlink takes no notice of a listener that goes away amid an event; umockdev
// ends the program where its socket closes between connect and send. Called instead of libc's.
extern "C" ssize_t sendmsg(int fd, const msghdr* message, int flags) {
  using Send = ssize_t (*)(int, const msghdr*, int);
  static const auto kNext = reinterpret_cast<Send>(dlsym(RTLD_NEXT, "sendmsg"));
  const ssize_t n = kNext(fd, message, flags);
  if (n >= 0 || errno != ECONNREFUSED) {
    return n;
  }
  ssize_t told = 0;
  for (std::size_t i = 0; i < message->msg_iovlen; ++i) {
    told += static_cast<ssize_t>(message->msg_iov[i].iov_len);
  }
  return told;
}

namespace haarlight::firmware_iface {

namespace {

struct DataUnref {
  void operator()(UMockdevIoctlData* d) const noexcept { umockdev_ioctl_data_unref(d); }
};
using DataPtr = std::unique_ptr<UMockdevIoctlData, DataUnref>;

struct ObjectUnref {
  void operator()(void* object) const noexcept { g_object_unref(object); }
};

DataPtr resolve(UMockdevIoctlData* data, std::size_t offset, std::size_t n) {
  return DataPtr(umockdev_ioctl_data_resolve(data, offset, n, nullptr));
}

/// A request block of usbfs that the host has submitted.
struct Block {
  UMockdevIoctlClient* owner = nullptr;  ///< the open node it came by
  DataPtr urb;
  DataPtr buffer;
  bool is_done = false;
  bool hangs = false;

  [[nodiscard]] usbdevfs_urb& fields() const {
    return *reinterpret_cast<usbdevfs_urb*>(urb->data);
  }
  /// With what an IN transfer brought, `offset` bytes into the buffer.
  void finish(int status, const std::vector<std::uint8_t>& data, std::size_t offset) {
    const auto room = buffer ? static_cast<std::size_t>(buffer->data_len) : std::size_t{0};
    const std::size_t n = room > offset ? std::min(data.size(), room - offset) : 0;
    if (n > 0) {
      std::vector<std::uint8_t> copy(data.begin(),
                                     data.begin() + static_cast<std::ptrdiff_t>(n));
      umockdev_ioctl_data_update(buffer.get(), offset, copy.data(), static_cast<int>(n));
    }
    finish(status, static_cast<int>(n));
  }
  void finish(int status, int n_bytes) {
    usbdevfs_urb changed = fields();
    changed.status = status;
    changed.actual_length = n_bytes;
    std::vector<std::uint8_t> bytes(sizeof changed);
    std::memcpy(bytes.data(), &changed, sizeof changed);
    umockdev_ioctl_data_update(urb.get(), 0, bytes.data(), static_cast<int>(bytes.size()));
    is_done = true;
  }
};

constexpr std::size_t kSetupBytes = 8;

sim::UsbSetup setup_of(const std::uint8_t* bytes) {
  const auto word = [bytes](std::size_t i) {
    return static_cast<std::uint16_t>(bytes[i] | (bytes[i + 1] << 8U));
  };
  return {bytes[0], bytes[1], word(2), word(4), word(6)};
}

int status_of(sim::UsbStatus status) { return status == sim::UsbStatus::stall ? -EPIPE : 0; }

}  // namespace

/// usbfs of one plugged device.
struct MockNode {
  sim::UsbLightDevice* device = nullptr;
  std::string syspath;
  std::string node;
  std::unique_ptr<UMockdevIoctlBase, ObjectUnref> handler;
  std::mutex mutex;  // handler thread and test
  std::list<Block> blocks;
  UMockdevIoctlClient* claimant = nullptr;
  bool is_gone = false;
  int n_to_hold = 0;
  std::vector<UMockdevIoctlClient*> held;

  static gboolean on_ioctl(UMockdevIoctlBase* /*base*/, UMockdevIoctlClient* client,
                           gpointer self) {
    auto& node = *static_cast<MockNode*>(self);
    const std::lock_guard lock(node.mutex);
    const int error = node.serve(client);
    if (error >= 0) {
      umockdev_ioctl_client_complete(client, error == 0 ? 0 : -1, error);
    }
    return TRUE;
  }

  static void on_vanished(UMockdevIoctlBase* /*base*/, UMockdevIoctlClient* client,
                          gpointer self) {
    auto& node = *static_cast<MockNode*>(self);
    const std::lock_guard lock(node.mutex);
    if (node.claimant == client) {
      node.claimant = nullptr;
    }
  }

  /// An errno, or -1: not answered yet.
  int serve(UMockdevIoctlClient* client) {
    UMockdevIoctlData* arg = umockdev_ioctl_client_get_arg(client);
    const gulong request = umockdev_ioctl_client_get_request(client);
    if (request == USBDEVFS_REAPURBNDELAY) {
      return reap(client, arg);
    }
    if (request == USBDEVFS_DISCARDURB) {
      return discard(arg);
    }
    if (request == USBDEVFS_RELEASEINTERFACE) {
      claimant = claimant == client ? nullptr : claimant;
      return 0;
    }
    if (is_gone) {
      return ENODEV;
    }
    switch (request) {
      case USBDEVFS_GET_CAPABILITIES: {
        const DataPtr where = resolve(arg, 0, sizeof(std::uint32_t));
        std::uint32_t abilities = USBDEVFS_CAP_ZERO_PACKET | USBDEVFS_CAP_NO_PACKET_SIZE_LIM |
                                  USBDEVFS_CAP_REAP_AFTER_DISCONNECT;
        umockdev_ioctl_data_update(where.get(), 0, reinterpret_cast<guint8*>(&abilities),
                                   sizeof abilities);
        return 0;
      }
      case USBDEVFS_CLAIMINTERFACE:
        if (claimant != nullptr && claimant != client) {
          return EBUSY;
        }
        claimant = client;
        return 0;
      case USBDEVFS_CLEAR_HALT: {
        const DataPtr where = resolve(arg, 0, sizeof(unsigned));
        unsigned endpoint = 0;
        std::memcpy(&endpoint, where->data, sizeof endpoint);
        device->clear_halt(static_cast<std::uint8_t>(endpoint));
        return 0;
      }
      case USBDEVFS_SUBMITURB:
        return submit(client, arg);
      default:
        return ENOTTY;
    }
  }

  int submit(UMockdevIoctlClient* client, UMockdevIoctlData* arg) {
    Block block;
    block.owner = client;
    block.urb = resolve(arg, 0, sizeof(usbdevfs_urb));
    const usbdevfs_urb urb = block.fields();
    if (urb.buffer_length > 0) {
      block.buffer = resolve(block.urb.get(), offsetof(usbdevfs_urb, buffer),
                             static_cast<std::size_t>(urb.buffer_length));
    }
    begin(block, urb);
    blocks.push_back(std::move(block));
    return 0;
  }

  void begin(Block& block, const usbdevfs_urb& urb) {
    sim::UsbAnswer answer;
    std::size_t offset = 0;
    int n_out = 0;
    if (urb.type == USBDEVFS_URB_TYPE_CONTROL) {
      offset = kSetupBytes;
      const sim::UsbSetup setup = setup_of(block.buffer->data);
      answer = device->control(setup, {});
    } else if ((urb.endpoint & 0x80U) != 0) {
      answer = device->begin_bulk_in();
    } else {
      n_out = urb.buffer_length;
      answer = device->bulk_out(
          {block.buffer->data, static_cast<std::size_t>(block.buffer->data_len)});
    }
    settle(block, answer, offset, n_out);
  }

  void settle(Block& block, const sim::UsbAnswer& answer, std::size_t offset, int n_out) {
    switch (answer.status) {
      case sim::UsbStatus::ok:
      case sim::UsbStatus::stall:
        if (n_out > 0) {
          block.finish(status_of(answer.status), n_out);
        } else {
          block.finish(status_of(answer.status), answer.data, offset);
        }
        return;
      case sim::UsbStatus::pending:
        return;
      case sim::UsbStatus::hang:
        block.hangs = true;
        return;
      case sim::UsbStatus::gone:
        block.finish(-ESHUTDOWN, 0);
        leave();
        return;
    }
  }

  void leave() {
    is_gone = true;
    for (Block& block : blocks) {
      if (!block.is_done) {
        block.finish(-ESHUTDOWN, 0);
      }
    }
  }

  int reap(UMockdevIoctlClient* client, UMockdevIoctlData* arg) {
    if (n_to_hold > 0) {
      --n_to_hold;
      held.push_back(static_cast<UMockdevIoctlClient*>(g_object_ref(client)));
      return -1;
    }
    for (Block& block : blocks) {
      if (block.owner == client && !block.is_done && !block.hangs) {
        settle(block, device->poll_bulk_in(), 0, 0);
      }
    }
    for (auto it = blocks.begin(); it != blocks.end(); ++it) {
      if (it->owner == client && it->is_done) {
        // The pointer must be resolved before it can be set.
        const DataPtr where = resolve(arg, 0, sizeof(void*));
        umockdev_ioctl_data_set_ptr(where.get(), 0, it->urb.get());
        blocks.erase(it);
        return 0;
      }
    }
    return is_gone ? ENODEV : EAGAIN;
  }

  int discard(UMockdevIoctlData* arg) {
    gulong address = 0;
    std::memcpy(&address, arg->data, sizeof address);
    for (Block& block : blocks) {
      if (block.urb->client_addr == address && !block.is_done) {
        block.finish(-ENOENT, 0);
        return 0;
      }
    }
    return EINVAL;
  }
};

class UsbTestbed::Impl {
 public:
  Impl() : testbed(umockdev_testbed_new()) {}

  std::unique_ptr<UMockdevTestbed, ObjectUnref> testbed;
  std::list<std::unique_ptr<MockNode>> nodes;
  int next_address = 2;
};

UsbTestbed::UsbTestbed() : impl_(std::make_unique<Impl>()) {}
UsbTestbed::~UsbTestbed() {
  release_completions();
  for (auto& node : impl_->nodes) {
    umockdev_testbed_detach_ioctl(impl_->testbed.get(), node->node.c_str(), nullptr);
  }
}

void UsbTestbed::plug(sim::UsbLightDevice& device) {
  const int address = impl_->next_address++;
  auto node = std::make_unique<MockNode>();
  node->device = &device;
  node->node = fmt::format("/dev/bus/usb/001/{:03d}", address);
  const std::string path = fmt::format("/devices/pci0000:00/usb1/1-{}", address);
  node->syspath = "/sys" + path;
  std::string descriptors;
  for (const auto& bytes : {device.device_descriptor(), device.configuration_descriptor()}) {
    for (const std::uint8_t byte : bytes) {
      descriptors += fmt::format("{:02X}", byte);
    }
  }
  device.reset();
  const std::string text = fmt::format(
      "P: {}\nN: bus/usb/001/{:03d}\nE: BUSNUM=001\nE: DEVNAME=/dev/bus/usb/001/{:03d}\n"
      "E: DEVNUM={:03d}\nE: DEVTYPE=usb_device\nE: SUBSYSTEM=usb\nE: MAJOR=189\nE: MINOR={}\n"
      "A: bConfigurationValue=1\\n\nA: busnum=1\\n\nA: devnum={}\\n\nA: speed=480\\n\n"
      "A: bNumConfigurations=1\\n\nH: descriptors={}\n",
      path, address, address, address, address - 1, address, descriptors);
  node->handler.reset(umockdev_ioctl_base_new());
  g_signal_connect(node->handler.get(), "handle-ioctl", G_CALLBACK(&MockNode::on_ioctl),
                   node.get());
  g_signal_connect(node->handler.get(), "client-vanished", G_CALLBACK(&MockNode::on_vanished),
                   node.get());
  GError* error = nullptr;
  if (!umockdev_testbed_add_from_string(impl_->testbed.get(), text.c_str(), &error) ||
      !umockdev_testbed_attach_ioctl(impl_->testbed.get(), node->node.c_str(),
                                     node->handler.get(), &error)) {
    throw std::runtime_error(error != nullptr ? error->message : "umockdev");
  }
  umockdev_testbed_uevent(impl_->testbed.get(), node->syspath.c_str(), "add");
  impl_->nodes.push_back(std::move(node));
}

void UsbTestbed::unplug(sim::UsbLightDevice& device) {
  for (auto& node : impl_->nodes) {
    if (node->device != &device || node->syspath.empty()) {
      continue;
    }
    {
      const std::lock_guard lock(node->mutex);
      node->leave();
    }
    umockdev_testbed_uevent(impl_->testbed.get(), node->syspath.c_str(), "remove");
    umockdev_testbed_remove_device(impl_->testbed.get(), node->syspath.c_str());
    node->syspath.clear();  // the handler stays: somebody may still have the node open
  }
}

bool UsbTestbed::is_off(const sim::UsbLightDevice& device) const {
  for (auto& node : impl_->nodes) {
    const std::lock_guard lock(node->mutex);
    if (node->device == &device && !node->syspath.empty() && node->is_gone) {
      return true;
    }
  }
  return false;
}

void UsbTestbed::hold_completions(int n_users) {
  for (auto& node : impl_->nodes) {
    const std::lock_guard lock(node->mutex);
    node->n_to_hold = n_users;
  }
}

void UsbTestbed::release_completions() {
  for (auto& node : impl_->nodes) {
    const std::lock_guard lock(node->mutex);
    node->n_to_hold = 0;
    for (UMockdevIoctlClient* client : node->held) {
      umockdev_ioctl_client_complete(client, -1, EAGAIN);
      g_object_unref(client);
    }
    node->held.clear();
  }
}

int UsbTestbed::n_holding() const {
  std::size_t n = 0;
  for (auto& node : impl_->nodes) {
    const std::lock_guard lock(node->mutex);
    n += node->held.size();
  }
  return static_cast<int>(n);
}

int UsbTestbed::n_claimed() const {
  int n = 0;
  for (auto& node : impl_->nodes) {
    const std::lock_guard lock(node->mutex);
    n += node->claimant != nullptr ? 1 : 0;
  }
  return n;
}

void require_mock_environment(char** argv) {
  if (umockdev_in_mock_environment()) {
    return;
  }
  const char* const loaded = std::getenv("LD_PRELOAD");
  if (loaded != nullptr && std::strstr(loaded, "umockdev") != nullptr) {
    return;  // once is enough: the tests will say what is wrong
  }
  const std::string libraries =
      "libumockdev-preload.so.0" + (loaded != nullptr ? ":" + std::string(loaded) : "");
  ::setenv("LD_PRELOAD", libraries.c_str(), 1);
  // AddressSanitizer wants to come first in the list of libraries; second does as well.
  const char* const options = std::getenv("ASAN_OPTIONS");
  const std::string more = (options != nullptr ? std::string(options) + ":" : std::string()) +
                           "verify_asan_link_order=0";
  ::setenv("ASAN_OPTIONS", more.c_str(), 1);
  ::execv("/proc/self/exe", argv);
  throw std::runtime_error("the test program could not start itself anew");
}

}  // namespace haarlight::firmware_iface
