// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/io/mesh_file.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <openssl/rand.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <thread>

#include "adapters/ble_mesh_usb_cdc/provisioning/mesh_json.hpp"
#include "daemon/runtime/owned_file.hpp"

namespace slamgw::ble {
namespace {

std::string last_error() { return std::strerror(errno); }

bool write_all(int file, std::string_view text) {
  while (!text.empty()) {
    const ssize_t written = ::write(file, text.data(), text.size());
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) return false;
    text.remove_prefix(static_cast<std::size_t>(written));
  }
  return true;
}

constexpr int read_attempts = 10;
constexpr std::chrono::seconds read_pause{1};

/// Returns 0 or an errno value.
int read_file(const std::string& path, std::string& content) {
  content.clear();
  const OwnedFile file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (file.get() < 0) return errno;
  std::array<char, 4096> part{};
  ssize_t size = 0;
  while ((size = ::read(file.get(), part.data(), part.size())) > 0)
    content.append(part.data(), static_cast<std::size_t>(size));
  return size < 0 ? errno : 0;
}

/// Writes a new file with mode 0600 and waits until it is on disk.
bool write_file(const std::string& path, std::string_view text) {
  const OwnedFile file(::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600));
  return file.get() >= 0 && write_all(file.get(), text) && ::fsync(file.get()) == 0;
}

bool sync_directory(const std::string& path) {
  const OwnedFile directory(::open(path.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  return directory.get() >= 0 && ::fsync(directory.get()) == 0;
}

/// Returns why this gateway must not use the address; empty if it may. If two senders in a mesh
/// share an address, robots drop the messages of one of them.
std::string problem_with_address(const NodeDatabase& database, std::uint16_t address) {
  if (std::ranges::find(database.gateways, address) != database.gateways.end())
    return fmt::format(
        "ble_mesh.address 0x{:04x} was given to another gateway of this mesh: choose a free "
        "address",
        address);
  if (database.guest_address && *database.guest_address != address)
    return fmt::format(
        "ble_mesh.address must be 0x{:04x}, which the gateway that provisions this mesh has given "
        "this one",
        *database.guest_address);
  if (const Node* const taken = database.find_address(address))
    return fmt::format(
        "ble_mesh.address 0x{:04x} is a robot's (UUID {} in mesh.json): choose a free address",
        address, to_hex(taken->uuid));
  return {};
}

}  // namespace

Result<std::optional<NodeDatabase>, Refusal> MeshFile::load(std::uint16_t address) const {
  std::string content;
  int error = read_file(path_, content);
  // Waits for a disk that fails for a moment: without its keys the whole mesh would stay off.
  for (int again = 0; error == EIO && again < read_attempts; ++again) {
    std::this_thread::sleep_for(read_pause);
    error = read_file(path_, content);
  }
  if (error == ENOENT) return std::optional<NodeDatabase>();
  if (error != 0)
    return Refusal{
        fmt::format("{} can't be read ({}): the BLE mesh stays off", path_, std::strerror(error))};
  const auto database = decode_node_database(content);
  if (!database.has_value())
    return Refusal{fmt::format(
        "{} is damaged or of another version: the BLE mesh stays off. It holds the mesh's keys: "
        "restore it from a backup; without it every robot must be provisioned again (move it away "
        "to start a new mesh)",
        path_)};
  if (std::string problem = problem_with_address(*database, address); !problem.empty())
    return Refusal{std::move(problem)};
  return std::optional(*database);
}

std::string MeshFile::write(const NodeDatabase& database, bool is_new) const {
  const std::string temporary = path_ + ".new";
  const std::string directory = std::filesystem::path(path_).parent_path();
  if (!write_file(temporary, encode_node_database(database)))
    return fmt::format("the mesh's keys can't be stored in {}: {}", temporary, last_error());
  // link() fails if the file has appeared since.
  const auto put_in_place = is_new ? ::link : ::rename;
  const bool is_there = put_in_place(temporary.c_str(), path_.c_str()) == 0;
  const std::string why = is_there ? std::string() : last_error();
  ::unlink(temporary.c_str());
  if (!is_there) return fmt::format("the mesh's keys can't be stored in {}: {}", path_, why);
  if (sync_directory(directory)) return {};
  std::string problem = fmt::format("{} can't be made safe on disk: {}", directory, last_error());
  if (is_new) ::unlink(path_.c_str());  // these keys are not used; the next ones need the place
  return problem;
}

bool fill_random(std::span<std::uint8_t> octets) {
  return RAND_bytes(octets.data(), static_cast<int>(octets.size())) == 1;
}

}  // namespace slamgw::ble
