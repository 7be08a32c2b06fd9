// SPDX-License-Identifier: Apache-2.0
// The questions and commands for a board that is in step, in an order that is safe whatever state
// it is in: first read, then add what is missing, and stop rather than change another tool's
// configuration. Never clears the board; asks for that when the board has the keys that this mesh
// had before its key refresh. A board without an address has forgotten its sequence
// numbers, and robots would discard what it sends from an address that they have heard before: the
// caller says which address a board sends from. No timing: one command, its response, the next.
// Called by BoardLink.
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
#include "daemon/core/messages.hpp"

namespace slamgw::ble {

class AddressBook {
 public:
  /// The stock firmware's table of group and unicast addresses.
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
  /// The handle to send to `address` with; marks it as just used.
  std::optional<std::uint16_t> publication_handle(std::uint16_t address) {
    const auto found = std::ranges::find(publications_, address, &Publication::address);
    if (found == publications_.end()) return std::nullopt;
    publications_.splice(publications_.begin(), publications_, found);
    return found->handle;
  }
  /// The board no longer knows this handle.
  void forget_publication(std::uint16_t address) {
    publications_.remove_if([&](const Publication& p) { return p.address == address; });
  }
  bool is_full() const { return subscriptions_.size() + publications_.size() >= max_addresses; }
  /// Takes out the publication that was not used for longest.
  std::optional<Publication> take_least_recent() {
    if (publications_.empty()) return std::nullopt;
    const Publication last = publications_.back();
    publications_.pop_back();
    return last;
  }

 private:
  std::set<std::uint16_t> subscriptions_;
  std::list<Publication> publications_;  ///< most recently used first
};

struct BoardSettings {
  std::uint16_t address = 0x0001;  ///< that robots publish to
  std::vector<std::uint16_t> groups;
  std::uint8_t ttl = 4;  ///< of what is sent
};

/// A board after start-up: its own values, and the handles and addresses that it was given.
struct StartedBoard {
  SerialVersion version = SerialVersion::sdk_3_1;
  std::string uuid = {};                             ///< in hex; empty when it did not answer
  std::uint16_t source = 0;                          ///< the address to send from
  std::optional<std::uint32_t> dropped_events = {};  ///< since its reset, if it says
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

  /// Without `keys` a board that holds keys is used as it is, and a fresh one asks for some.
  StartUp(BoardSettings settings, std::optional<RadioKeys> keys);

  State state() const { return state_; }
  /// While commanding: the frame to send now.
  Bytes command() const;
  /// The response to that command.
  void on_response(const CommandResponse& response);
  /// While in `needs_keys`.
  void on_keys(const MeshKeys& keys);
  /// While in `needs_source`: the address to send from, and how many from
  /// `BoardSettings::address` up a board without one gets.
  void on_source(std::uint16_t source, std::uint16_t count);

  /// Why it refused, for the operator.
  const std::string& refusal() const { return refusal_; }
  /// What the operator should read; empties the list.
  std::vector<Notice> take_notices() { return std::exchange(notices_, {}); }

  /// Complete when done.
  const StartedBoard& board() const { return board_; }
  /// How many addresses the board had; without one, it has no sequence number of this mesh.
  std::uint16_t had_addresses() const { return had_addresses_; }
  /// For `status`: protocol version and UUID.
  std::string description() const;

 private:
  /// In this order, where no response says otherwise.
  enum class Step : std::uint8_t {
    get_version,
    get_uuid,
    get_dropped_events,
    get_address,
    get_subnets,
    set_address,
    find_former,
    add_subnet,
    update_subnet,
    get_appkeys,
    add_appkey,
    update_appkey,
    get_handles,
    read_handle,
    add_group,
    enable
  };

  void on_version(const CommandResponse& response);
  void on_address(const CommandResponse& response);
  void on_subnets(const CommandResponse& response);
  void on_former_sought(const CommandResponse& response);
  void on_subnet_added(const CommandResponse& response);
  void on_appkeys(const CommandResponse& response);
  void on_appkey_added(const CommandResponse& response);
  bool is_updated(const CommandResponse& response, std::string_view what);
  void on_keys_complete();
  void on_handles(const CommandResponse& response);
  void on_handle_read(const CommandResponse& response);
  void on_group_added(const CommandResponse& response);
  void on_enabled(const CommandResponse& response);

  void begin_writing();
  Step first_key_step() const;
  void read_next_handle();
  void add_next_group();
  void refuse(std::string why);
  /// Reads the handle of a key that was added. `listed`: the key indexes that the board had before,
  /// in the order of its table, so that an index's place in it is the key's handle.
  bool take_handle(const CommandResponse& response, const std::vector<std::uint16_t>& listed,
                   std::uint16_t& handle, std::string_view what);
  /// True when `response` is success and holds what it must; refuses otherwise. Octets beyond
  /// those are ignored: firmware newer than this file may send more.
  bool check(const CommandResponse& response, bool is_complete, std::string_view what);
  void notice(Severity severity, std::string text);

  BoardSettings settings_;
  std::optional<RadioKeys> keys_;
  State state_ = State::commanding;
  Step step_ = Step::get_version;
  std::string refusal_;
  std::vector<Notice> notices_;

  StartedBoard board_;
  std::uint16_t had_addresses_ = 0;
  std::uint16_t count_ = 1;
  bool is_fresh_ = false;                      ///< it had neither address nor keys
  std::vector<std::uint16_t> subnet_indexes_;  ///< as listed by the board
  std::vector<std::uint16_t> appkey_indexes_;
  std::deque<std::uint16_t> unread_handles_;  ///< front: the one being read
  std::deque<std::uint16_t> missing_groups_;  ///< front: the one being added
};

}  // namespace slamgw::ble
