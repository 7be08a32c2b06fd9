// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/nordic/start_up.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <utility>

namespace slamgw::ble {
namespace {

constexpr std::uint16_t key_index = 0;  // of both keys: one mesh, one application

std::vector<std::uint16_t> read_numbers(ByteReader& data) {
  std::vector<std::uint16_t> numbers;
  while (data.remaining() >= 2) numbers.push_back(data.read_u16_le());
  return numbers;
}

}  // namespace

StartUp::StartUp(Settings settings, std::optional<RadioKeys> keys)
    : settings_(std::move(settings)), keys_(keys) {
  board_.source = settings_.address;
  ask(&StartUp::on_version, CommandOpcode::serial_version_get);
}

void StartUp::on_version(const CommandResponse& response) {
  ByteReader data(response.data);
  const SerialVersion version{data.read_u16_le()};
  const bool is_known = response.status == Status::success && data.ok();
  if (is_known && version < SerialVersion::sdk_1_0)
    return refuse(
        fmt::format("its firmware speaks version {} of Nordic's serial protocol, older than that "
                    "of nRF5 SDK for Mesh 1.0: program the serial example of a newer SDK",
                    static_cast<unsigned>(version)));
  if (is_known) board_.version = version;
  ask(&StartUp::on_uuid, CommandOpcode::uuid_get);
}

void StartUp::on_uuid(const CommandResponse& response) {
  if (response.status == Status::success) board_.uuid = to_hex(response.data);
  ask(&StartUp::on_dropped_events, CommandOpcode::housekeeping_get);
}

void StartUp::on_dropped_events(const CommandResponse& response) {
  ByteReader data(response.data);
  if (response.status == Status::success && data.remaining() >= 4)
    board_.dropped_events = data.read_u32_le();
  ask(&StartUp::on_address, CommandOpcode::local_unicast_get);
}

void StartUp::on_address(const CommandResponse& response) {
  ByteReader data(response.data);
  const std::uint16_t address = data.read_u16_le();
  const std::uint16_t count = data.read_u16_le();
  if (!check(response, data.ok(), "reporting its unicast address")) return;
  had_addresses_ = count;
  if (count != 0 && address != settings_.address) {
    return refuse(fmt::format(
        "it is configured with unicast address 0x{:04x}, but ble_mesh.address is 0x{:04x}: set "
        "ble_mesh.address to the board's, or clear the board with slam-gatewayctl ble reset-board "
        "--yes",
        address, settings_.address));
  }
  ask(&StartUp::on_subnets, CommandOpcode::subnet_get_all);
}

void StartUp::on_subnets(const CommandResponse& response) {
  ByteReader data(response.data);
  subnet_indexes_ = read_numbers(data);
  if (!check(response, true, "listing its network keys")) return;
  is_fresh_ = had_addresses_ == 0 && subnet_indexes_.empty();
  if (!keys_ && subnet_indexes_.empty()) {
    state_ = State::needs_keys;
    return;
  }
  if (!keys_)
    notice(
        Severity::warning,
        "the serial board already holds a network key and no mesh.json exists here: the board is "
        "used as it is, and its robots are heard, but none can join or be removed; restore "
        "mesh.json from a backup, or bring the mesh in with slam-gatewayctl ble import");
  begin_writing();
}

void StartUp::on_keys(const RadioKeys& keys) {
  assert(state_ == State::needs_keys);
  keys_ = keys;
  begin_writing();
}

/// Without keys there is no mesh.json that records the used addresses, so none is asked for.
void StartUp::begin_writing() {
  if (had_addresses_ > 0) return begin_keys();
  if (!keys_) return set_address(1);
  state_ = State::needs_source;
}

/// A board that has addresses was asked for its keys already.
void StartUp::on_source(std::uint16_t source, std::uint16_t count) {
  assert(state_ == State::needs_source);
  board_.source = source;
  had_addresses_ > 0 ? list_handles() : set_address(count);
}

void StartUp::set_address(std::uint16_t count) {
  ask(&StartUp::on_address_set, CommandOpcode::local_unicast_set, settings_.address, count);
}

void StartUp::on_address_set(const CommandResponse& response) {
  if (check(response, true, "taking the gateway's unicast address")) begin_keys();
}

void StartUp::begin_keys() {
  if (!keys_) return list_appkeys();
  const bool has_key = std::ranges::find(subnet_indexes_, key_index) != subnet_indexes_.end();
  if (!keys_->former || !has_key) return add_subnet();
  ask(&StartUp::on_former_sought, CommandOpcode::subnet_add, key_index, keys_->former->net_key);
}

/// The status `internal` ("the very same key") proves that the board has the mesh's former key. It
/// has missed the key refresh, or hears the old key, too. No command removes the old key.
void StartUp::on_former_sought(const CommandResponse& response) {
  if (response.status != Status::internal) return add_subnet();
  state_ = State::needs_clear;
}

void StartUp::add_subnet() {
  ask(&StartUp::on_subnet_added, CommandOpcode::subnet_add, key_index, keys_->keys.net_key);
}

void StartUp::on_subnet_added(const CommandResponse& response) {
  if (response.status == Status::rejected) {
    return refuse(
        "it holds another network key than this gateway's mesh.json: it belongs to another mesh, "
        "or its key arrived damaged; attach this mesh's board, or clear this one with "
        "slam-gatewayctl ble reset-board --yes, or move mesh.json away to use the board with its "
        "own keys");
  }
  if (!take_handle(response, subnet_indexes_, board_.subnet_handle, "taking the network key"))
    return;
  if (is_fresh_)
    notice(
        Severity::notice,
        fmt::format("the serial board was fresh and got this mesh's keys; it sends from 0x{:04x}",
                    board_.source));
  if (!keys_->next) return list_appkeys();
  ask(&StartUp::on_subnet_updated, CommandOpcode::subnet_update, board_.subnet_handle,
      keys_->next->net_key);
}

void StartUp::on_subnet_updated(const CommandResponse& response) {
  if (is_updated(response, "taking the new network key")) list_appkeys();
}

void StartUp::list_appkeys() {
  ask(&StartUp::on_appkeys, CommandOpcode::appkey_get_all, board_.subnet_handle);
}

/// "Invalid state": the board has switched to the new key by itself, after a node's beacon.
bool StartUp::is_updated(const CommandResponse& response, std::string_view what) {
  return response.status == Status::invalid_state || check(response, true, what);
}

bool StartUp::take_handle(const CommandResponse& response, const std::vector<std::uint16_t>& listed,
                          std::uint16_t& handle, std::string_view what) {
  const auto known = std::ranges::find(listed, key_index);
  if (response.status == Status::internal && known != listed.end()) {
    handle = static_cast<std::uint16_t>(known - listed.begin());  // the very same key is there
    return true;
  }
  ByteReader data(response.data);
  handle = data.read_u16_le();
  return check(response, data.ok(), what);
}

void StartUp::on_appkeys(const CommandResponse& response) {
  ByteReader data(response.data);
  // Without application keys Nordic's firmware sends no data at all; otherwise the list follows the
  // handle of the subnet.
  if (data.remaining() >= 2) data.read_u16_le();
  appkey_indexes_ = read_numbers(data);
  if (!check(response, true, "listing its application keys")) return;
  if (keys_)
    return ask(&StartUp::on_appkey_added, CommandOpcode::appkey_add, key_index,
               board_.subnet_handle, keys_->keys.app_key);
  if (appkey_indexes_.empty())
    return refuse(
        "it holds a network key but no application key, and no mesh.json exists here: give it the "
        "mesh's application key with Nordic's tools");
  list_handles();
}

void StartUp::on_appkey_added(const CommandResponse& response) {
  if (response.status == Status::rejected)
    return refuse(
        "it holds another application key than this gateway's mesh.json: it belongs to another "
        "mesh, or its key arrived damaged; slam-gatewayctl ble reset-board --yes clears it");
  if (!take_handle(response, appkey_indexes_, board_.appkey_handle, "taking the application key"))
    return;
  if (!keys_->next) return on_keys_complete();
  ask(&StartUp::on_appkey_updated, CommandOpcode::appkey_update, board_.appkey_handle,
      keys_->next->app_key);
}

void StartUp::on_appkey_updated(const CommandResponse& response) {
  if (is_updated(response, "taking the new application key")) on_keys_complete();
}

void StartUp::on_keys_complete() {
  if (had_addresses_ == 0) return list_handles();
  state_ = State::needs_source;
}

void StartUp::list_handles() { ask(&StartUp::on_handles, CommandOpcode::address_get_all); }

void StartUp::on_handles(const CommandResponse& response) {
  ByteReader data(response.data);
  const auto handles = read_numbers(data);
  if (!check(response, true, "listing its address handles")) return;
  unread_handles_.assign(handles.begin(), handles.end());
  read_next_handle();
}

void StartUp::read_next_handle() {
  if (!unread_handles_.empty())
    return ask(&StartUp::on_handle_read, CommandOpcode::address_get, unread_handles_.front());
  for (const std::uint16_t group : settings_.heard_groups()) {
    if (!board_.addresses.is_subscribed(group)) missing_groups_.push_back(group);
  }
  add_next_group();
}

void StartUp::on_handle_read(const CommandResponse& response) {
  ByteReader data(response.data);
  AddressBook::Publication entry;
  entry.handle = data.read_u16_le();
  data.read_u8();  // the address type, which the address itself shows
  const bool is_subscribed = data.read_u8() != 0;
  entry.address = data.read_u16_le();
  // A handle that has vanished since it was listed is not an error.
  if (response.status == Status::success && data.ok()) {
    if (is_subscribed) {
      board_.addresses.add_subscription(entry.address);
    } else if (entry.address <= last_unicast_address) {
      board_.addresses.add_publication(entry);
    }
  }
  unread_handles_.pop_front();
  read_next_handle();
}

void StartUp::add_next_group() {
  if (missing_groups_.empty()) return ask(&StartUp::on_enabled, CommandOpcode::enable);
  ask(&StartUp::on_group_added, CommandOpcode::subscription_add, missing_groups_.front());
}

void StartUp::on_group_added(const CommandResponse& response) {
  const std::uint16_t group = missing_groups_.front();
  if (response.status == Status::success) {
    board_.addresses.add_subscription(group);
  } else {
    notice(Severity::warning,
           fmt::format("the serial board does not subscribe to group 0x{:04x} ({}): messages "
                       "to this group are not heard",
                       group, to_string(response.status)));
  }
  missing_groups_.pop_front();
  add_next_group();
}

void StartUp::on_enabled(const CommandResponse& response) {
  // "Invalid state": the board was enabled already, as stock firmware does by itself.
  if (response.status == Status::invalid_state || check(response, true, "enabling the mesh"))
    state_ = State::done;
}

bool StartUp::check(const CommandResponse& response, bool is_complete, std::string_view what) {
  if (response.status != Status::success) {
    refuse(fmt::format("it answers \"{}\" (0x{:02x}) to {} (command 0x{:02x})",
                       to_string(response.status), static_cast<unsigned>(response.status), what,
                       response.opcode));
    return false;
  }
  if (!is_complete)
    refuse(fmt::format(
        "its answer to command 0x{:02x} is too short: is its firmware Nordic's serial example?",
        response.opcode));
  return is_complete;
}

void StartUp::refuse(std::string why) {
  refusal_ = "the serial board can't be used: " + std::move(why);
  state_ = State::refused;
}

void StartUp::notice(Severity severity, std::string text) {
  notices_.push_back({severity, std::move(text), {}});
}

std::string StartUp::description() const {
  const std::string_view releases = sdk_releases(board_.version);
  return fmt::format("serial protocol version {}{}, board UUID {}",
                     static_cast<unsigned>(board_.version),
                     releases.empty() ? "" : fmt::format(" (nRF5 SDK for Mesh {})", releases),
                     board_.uuid.empty() ? "unknown" : board_.uuid);
}

}  // namespace slamgw::ble
