// SPDX-License-Identifier: Apache-2.0
// Devices become nodes, one at a time: who joins next, which address it gets, and what came of it.
// Part of Provisioner.
#pragma once

#include <functional>
#include <optional>
#include <string>

#include "adapters/ble_mesh_usb_cdc/provisioning/candidates.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/ecdh.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/join_permit.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_table.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/open_order.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/provisioning_session.hpp"

namespace slamgw::ble {

class Admission {
 public:
  /// The stock board remembers the sequence numbers of so many sources, and does not hear others.
  static constexpr std::size_t replay_list_size = 40;
  /// A node is taken for reset only when it says so and was not heard for this long.
  static constexpr Duration reset_silence = std::chrono::seconds{5};
  static constexpr Duration order_time_limit = std::chrono::seconds{150};

  /// Whether a conversation with the node is under way, so that it must not be provisioned anew.
  using IsBusy = std::function<bool(const Node&)>;

  /// All but `random` outlive it.
  Admission(const Settings& settings, const BoardState& board, NodeTable& nodes, OpenOrder& order,
            ProvisionerActions& actions, RandomSource random);

  void on_event(const ProvisioningEvent& event, TimePoint now);
  void on_link_down(TimePoint now);
  void on_command_ended(const CommandEnded& ended);

  /// Carries the session under way on. `is_board_free`: no command is in flight.
  void continue_session(bool is_board_free, TimePoint now);
  void choose_next(const IsBusy& is_busy, TimePoint now);
  /// The command that the session under way has for the board.
  std::optional<Bytes> command() const { return session_ ? session_->command() : std::nullopt; }
  std::optional<TimePoint> deadline() const {
    return session_ ? session_->deadline() : std::nullopt;
  }

  bool wants_scan() const;
  bool is_idle() const { return !session_ && !chosen_; }
  /// This device is joining now.
  bool is_joining(const Uuid& uuid) const { return session_ && session_->uuid() == uuid; }
  /// This device is joining now, or next.
  bool is_chosen(const Uuid& uuid) const {
    return is_joining(uuid) || (chosen_ && chosen_->uuid == uuid);
  }

  JoinPermit& permit() { return permit_; }
  const JoinPermit& permit() const { return permit_; }
  Candidates& candidates() { return candidates_; }

 private:
  /// A device that has its address and waits for the disk.
  struct Chosen {
    Uuid uuid{};
    bool is_last_context = false;  ///< the board's other context is busy
  };

  bool is_open() const { return settings_.provisioning.enabled || permit_.is_open(); }
  bool is_wanted(const Candidate& candidate, const IsBusy& is_busy, TimePoint now) const;
  bool was_silent(const Node& node, TimePoint now) const;
  bool reserve(const Candidate& candidate, const std::string& name, TimePoint now);
  void keep(const Candidate& candidate, std::uint16_t address, const std::string& name);
  bool make_room();
  void begin_session(TimePoint now);
  void keep_addresses(TimePoint now);
  void on_joined(TimePoint now);
  void on_session_failed(TimePoint now);
  void release(const Uuid& uuid);
  void warn_of_replay_list(const Node& node);
  void notify(Severity severity, std::string text, std::string robot = {}) {
    actions_.push(Notice{severity, std::move(text), std::move(robot)});
  }

  const Settings& settings_;
  const BoardState& board_;
  NodeTable& nodes_;
  OpenOrder& order_;
  ProvisionerActions& actions_;
  RandomSource random_;
  std::optional<Key> static_oob_;
  Candidates candidates_;
  JoinPermit permit_;
  std::optional<Chosen> chosen_;
  std::optional<ProvisioningSession> session_;
  std::uint8_t context_ = 0;      ///< of the session; the other one next time, as this may hang
  bool is_last_context_ = false;  ///< of the session
};

}  // namespace slamgw::ble
