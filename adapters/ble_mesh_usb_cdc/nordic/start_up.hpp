// SPDX-License-Identifier: Apache-2.0
// Starts up a board that is in step, in an order that is safe in any state of the board. It first
// reads, then adds missing parts, and stops rather than change another tool's configuration. It
// never clears the board, but asks for that when the board has the mesh's keys from before the key
// refresh. A board without an address has forgotten its sequence numbers, and robots discard its
// messages from an address that they have heard before. So the caller names the address to send
// from. It has no timing: a command is followed by its response, then by the next command. Called
// by BoardLink.
#pragma once

#include <algorithm>
#include <cstdint>
#include <deque>
#include <list>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/nordic/serial_protocol.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/messages.hpp"

namespace slamgw::ble {

/// The known part of the board's address table: subscribed groups, and handles of destinations.
class AddressBook {
 public:
  /// Size of the stock firmware's table of group and unicast addresses.
  static constexpr std::size_t max_addresses = 32;

  struct Publication {
    std::uint16_t address = 0;
    std::uint16_t handle = 0;
  };

  void add_subscription(std::uint16_t address) { subscriptions_.insert(address); }
  bool is_subscribed(std::uint16_t address) const { return subscriptions_.contains(address); }

  void add_publication(Publication publication) {
    forget_publication(publication.address);
    publications_.push_front(publication);
  }
  /// Returns the handle for sending to `address`, and marks it as just used.
  std::optional<std::uint16_t> publication_handle(std::uint16_t address) {
    const auto found = std::ranges::find(publications_, address, &Publication::address);
    if (found == publications_.end()) return std::nullopt;
    publications_.splice(publications_.begin(), publications_, found);
    return found->handle;
  }
  /// Call when the board no longer knows the handle of `address`.
  void forget_publication(std::uint16_t address) {
    publications_.remove_if([&](const Publication& p) { return p.address == address; });
  }
  bool is_full() const { return size() >= capacity_; }
  /// Call when the board has no room for another address: its table is smaller, or fuller, than
  /// known. Returns false if no publication can make room.
  bool on_full() {
    capacity_ = size();
    return !publications_.empty();
  }
  /// Removes and returns the publication that was unused for longest.
  std::optional<Publication> take_least_recent() {
    if (publications_.empty()) return std::nullopt;
    const Publication last = publications_.back();
    publications_.pop_back();
    return last;
  }

 private:
  std::size_t size() const { return subscriptions_.size() + publications_.size(); }

  std::size_t capacity_ = max_addresses;
  std::set<std::uint16_t> subscriptions_;
  std::list<Publication> publications_;  ///< most recently used first
};

/// A board after start-up: its own values, and the handles and addresses that it was given.
struct StartedBoard {
  SerialVersion version = SerialVersion::sdk_1_0;  ///< until it is known, the one that takes least
  std::string uuid = {};                           ///< in hex; empty if the board did not answer
  std::uint16_t source = 0;                        ///< the address to send from
  std::optional<std::uint32_t> dropped_events = {};  ///< since its reset, if reported
  std::uint16_t subnet_handle = 0;
  std::uint16_t appkey_handle = 0;
  AddressBook addresses = {};
};

class StartUp {
 public:
  enum class State : std::uint8_t {
    commanding,
    needs_keys,
    needs_source,
    needs_clear,
    refused,
    done
  };

  /// Without `keys`, a board that holds keys is used as it is; with a fresh board the state is
  /// `needs_keys`.
  StartUp(Settings settings, std::optional<RadioKeys> keys);

  State state() const { return state_; }
  /// Returns the frame to send now. Call only while `commanding`.
  const Bytes& command() const { return command_; }
  /// Takes the response to that command.
  void on_response(const CommandResponse& response) { (this->*on_response_)(response); }
  /// Call only in `needs_keys`.
  void on_keys(const RadioKeys& keys);
  /// Call only in `needs_source`. `source` is the address to send from. `count` is the number of
  /// addresses, from `ble_mesh.address` up, for a board that has none.
  void on_source(std::uint16_t source, std::uint16_t count);

  /// Returns why the board was refused, for the operator.
  const std::string& refusal() const { return refusal_; }
  /// Removes and returns the notices for the operator.
  std::vector<Notice> take_notices() { return std::exchange(notices_, {}); }

  /// Complete when the state is `done`.
  const StartedBoard& board() const { return board_; }
  /// Returns the number of the board's addresses before. 0: it has no sequence number of this mesh.
  std::uint16_t had_addresses() const { return had_addresses_; }
  /// Returns protocol version and UUID, for `status`.
  std::string description() const;

 private:
  using OnResponse = void (StartUp::*)(const CommandResponse& response);

  /// Makes the next command, whose response goes to `on_response`.
  template <class... Params>
  void ask(OnResponse on_response, CommandOpcode opcode, const Params&... params) {
    command_ = encode_command(opcode, params...);
    on_response_ = on_response;
    state_ = State::commanding;
  }

  void on_version(const CommandResponse& response);
  void on_uuid(const CommandResponse& response);
  void on_dropped_events(const CommandResponse& response);
  void on_address(const CommandResponse& response);
  void on_subnets(const CommandResponse& response);
  void on_address_set(const CommandResponse& response);
  void on_former_sought(const CommandResponse& response);
  void on_subnet_added(const CommandResponse& response);
  void on_subnet_updated(const CommandResponse& response);
  void on_appkeys(const CommandResponse& response);
  void on_appkey_added(const CommandResponse& response);
  void on_appkey_updated(const CommandResponse& response);
  bool is_updated(const CommandResponse& response, std::string_view what);
  void on_keys_complete();
  void on_handles(const CommandResponse& response);
  void on_handle_read(const CommandResponse& response);
  void on_group_added(const CommandResponse& response);
  void on_enabled(const CommandResponse& response);

  void begin_writing();
  void set_address(std::uint16_t count);
  void begin_keys();
  void add_subnet();
  void list_appkeys();
  void list_handles();
  void read_next_handle();
  void add_next_group();
  void refuse(std::string why);
  /// Reads the handle of a key that was added. `listed` has the key indexes that the board had
  /// before, in the order of its table: the place of an index is the key's handle.
  bool take_handle(const CommandResponse& response, const std::vector<std::uint16_t>& listed,
                   std::uint16_t& handle, std::string_view what);
  /// Returns true if `response` is a success and complete; otherwise refuses the board. Further
  /// octets are ignored: firmware newer than this file may send more.
  bool check(const CommandResponse& response, bool is_complete, std::string_view what);
  void notice(Severity severity, std::string text);

  Settings settings_;
  std::optional<RadioKeys> keys_;
  State state_ = State::commanding;
  Bytes command_;
  OnResponse on_response_ = nullptr;
  std::string refusal_;
  std::vector<Notice> notices_;

  StartedBoard board_;
  std::uint16_t had_addresses_ = 0;
  bool is_fresh_ = false;                      ///< the board had neither address nor keys
  std::vector<std::uint16_t> subnet_indexes_;  ///< as listed by the board
  std::vector<std::uint16_t> appkey_indexes_;
  std::deque<std::uint16_t> unread_handles_;  ///< front: being read
  std::deque<std::uint16_t> missing_groups_;  ///< front: being added
};

}  // namespace slamgw::ble
