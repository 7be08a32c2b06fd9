// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/io/serial_port.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <grp.h>
#include <libserialport.h>
#include <pwd.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "adapters/ble_mesh_usb_cdc/io/device_choice.hpp"
#include "daemon/runtime/owned_file.hpp"

namespace slamgw::ble {
namespace {

std::string last_serial_error() {
  char* const text = sp_last_error_message();
  std::string copy(text);
  sp_free_error_message(text);
  return copy;
}

UsbPort describe(sp_port* port) {
  UsbPort usb;
  usb.path = sp_get_port_name(port);
  int vendor = 0;
  int product = 0;
  if (sp_get_port_usb_vid_pid(port, &vendor, &product) == SP_OK) {
    usb.vendor = static_cast<std::uint16_t>(vendor);
    usb.product = static_cast<std::uint16_t>(product);
  }
  const char* const serial_number = sp_get_port_usb_serial(port);
  usb.serial_number = serial_number != nullptr ? serial_number : "unknown";
  return usb;
}

/// Sets speed, 8N1 and flow control. Returns an error message, empty if it worked.
std::string configure(sp_port* port, const Settings& settings, bool is_jlink) {
  const bool has_flow_control = settings.flow_control == FlowControl::rts_cts ||
                                (settings.flow_control == FlowControl::automatic && is_jlink);
  const bool is_configured =
      sp_set_baudrate(port, static_cast<int>(settings.baud_rate)) == SP_OK &&
      sp_set_bits(port, 8) == SP_OK && sp_set_parity(port, SP_PARITY_NONE) == SP_OK &&
      sp_set_stopbits(port, 1) == SP_OK &&
      sp_set_flowcontrol(port, has_flow_control ? SP_FLOWCONTROL_RTSCTS : SP_FLOWCONTROL_NONE) ==
          SP_OK;
  return is_configured ? std::string() : last_serial_error();
}

/// libserialport leaves VMIN at 0. Then an empty read returns 0 octets even where it should say
/// "try again", which SerialConnection takes for the end of the file.
bool let_empty_reads_wait(int descriptor) {
  termios attributes{};
  if (::tcgetattr(descriptor, &attributes) != 0) return false;
  attributes.c_cc[VMIN] = 1;
  attributes.c_cc[VTIME] = 0;
  return ::tcsetattr(descriptor, TCSANOW, &attributes) == 0;
}

/// Opens a terminal that is not a serial port: raw octets, nothing else to set. Locks it as
/// libserialport locks serial ports. Returns -1 with errno on failure.
int open_plain(const std::string& path) {
  OwnedFile port(::open(path.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
  termios attributes{};
  if (port.get() < 0 || ::flock(port.get(), LOCK_EX | LOCK_NB) != 0 ||
      ::tcgetattr(port.get(), &attributes) != 0)
    return -1;
  ::cfmakeraw(&attributes);
  return ::tcsetattr(port.get(), TCSANOW, &attributes) == 0 ? port.release() : -1;
}

std::string group_name(gid_t id) {
  std::array<char, 4096> buffer{};
  group entry{};
  group* found = nullptr;
  ::getgrgid_r(id, &entry, buffer.data(), buffer.size(), &found);
  return found != nullptr ? found->gr_name : std::to_string(id);
}

std::string user_name(uid_t id) {
  std::array<char, 4096> buffer{};
  passwd entry{};
  passwd* found = nullptr;
  ::getpwuid_r(id, &entry, buffer.data(), buffer.size(), &found);
  return found != nullptr ? found->pw_name : std::to_string(id);
}

/// Collects the facts for explain_open_failure(), as far as the system knows them. `error`: errno
/// of the attempt.
OpenRefusal refuse_open(const std::string& path, int error) {
  NodeAccess access;
  struct stat status {};
  if (::stat(path.c_str(), &status) == 0) {
    access.group = group_name(status.st_gid);
    access.mode = status.st_mode & 0777u;
  }
  access.process = user_name(::geteuid());
  return OpenRefusal{explain_open_failure(path, error, access), error == EACCES};
}

OpenRefusal refuse_configuration(const std::string& path, const std::string& why) {
  return OpenRefusal{fmt::format("{} can't be configured: {}", path, why)};
}

class Tty final : public SerialPort {
 public:
  Tty(sp_port* port, bool is_jlink) : port_(port), is_jlink_(is_jlink) {
    sp_get_port_handle(port_, &descriptor_);
  }
  /// A pseudo-terminal.
  explicit Tty(int descriptor) : descriptor_(descriptor) {}
  ~Tty() override {
    if (port_ == nullptr) {
      ::close(descriptor_);
      return;
    }
    sp_close(port_);
    sp_free_port(port_);
  }
  int descriptor() const override { return descriptor_; }
  /// J-Link bridges lose octets of longer writes (MBTLE-3878).
  std::size_t max_write_bytes() const override { return is_jlink_ ? 63 : 4096; }
  void set_dtr(bool is_on) override {
    if (port_ != nullptr) sp_set_dtr(port_, is_on ? SP_DTR_ON : SP_DTR_OFF);
  }
  void flush_input() override { ::tcflush(descriptor_, TCIFLUSH); }

 private:
  sp_port* port_ = nullptr;
  int descriptor_ = -1;
  bool is_jlink_ = false;
};

/// Returns the serial ports on USB.
std::vector<UsbPort> list_usb_ports() {
  std::vector<UsbPort> usb;
  sp_port** ports = nullptr;
  if (sp_list_ports(&ports) != SP_OK) return usb;
  for (sp_port** port = ports; *port != nullptr; ++port) {
    if (sp_get_port_transport(*port) == SP_TRANSPORT_USB) usb.push_back(describe(*port));
  }
  sp_free_port_list(ports);
  return usb;
}

struct DeviceNode {
  std::string path;
};

/// Returns the device node of `auto`, or behind a link such as those under /dev/serial/by-id/.
Result<DeviceNode, Refusal> resolve(const Settings& settings) {
  if (settings.device == "auto") {
    const auto chosen = choose_device(list_usb_ports());
    if (!chosen.has_value()) return chosen.error();
    return DeviceNode{chosen->path};
  }
  std::error_code error;
  const std::filesystem::path target = std::filesystem::canonical(settings.device, error);
  if (error)
    return Refusal{
        fmt::format("no serial board at {} ({}): plug it in, or set ble_mesh.device to one of "
                    "/dev/serial/by-id/",
                    settings.device, error.message())};
  return DeviceNode{target.string()};
}

}  // namespace

Result<std::unique_ptr<SerialPort>, OpenRefusal> open_serial_port(const Settings& settings) {
  const auto node = resolve(settings);
  if (!node.has_value()) return OpenRefusal{node.error().why};
  const std::string& path = node->path;
  sp_port* port = nullptr;
  if (sp_get_port_by_name(path.c_str(), &port) != SP_OK) {
    const int descriptor = open_plain(path);
    if (descriptor < 0) return refuse_open(path, errno);
    return std::unique_ptr<SerialPort>(std::make_unique<Tty>(descriptor));
  }
  const bool is_jlink = describe(port).vendor == jlink_vendor;
  if (sp_open(port, SP_MODE_READ_WRITE) != SP_OK) {
    const int error = sp_last_error_code();
    sp_free_port(port);
    return refuse_open(path, error);
  }
  auto opened = std::make_unique<Tty>(port, is_jlink);
  if (const std::string why = configure(port, settings, is_jlink); !why.empty())
    return refuse_configuration(path, why);
  if (!let_empty_reads_wait(opened->descriptor()))
    return refuse_configuration(path, std::strerror(errno));
  return std::unique_ptr<SerialPort>(std::move(opened));
}

}  // namespace slamgw::ble
