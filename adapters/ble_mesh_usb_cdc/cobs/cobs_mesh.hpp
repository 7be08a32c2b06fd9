// SPDX-License-Identifier: Apache-2.0
// Boards that only stream COBS frames: the thesis's positions, which carry no source and belong to
// one configured robot, or the older robots' frames with an address (lien_frame.hpp). There is no
// way to command a robot on such a link. Called by CobsAdapter.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/cobs/lien_connection.hpp"
#include "adapters/ble_mesh_usb_cdc/mesh_action.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/log_throttle.hpp"
#include "daemon/core/robot_names.hpp"
#include "daemon/core/topic_scheme.hpp"

namespace slamgw::ble {

using CobsAction = std::variant<WriteSerial, MeshEvent>;

class CobsMesh {
 public:
  /// With positions `settings.robot_id` is set.
  CobsMesh(Settings settings, TopicScheme topics, RobotNames names);

  void on_start();
  void on_port_open(TimePoint now);
  void on_port_closed(const std::string& why, TimePoint now);
  void on_bytes(ByteView bytes, TimePoint now);
  /// With positions the one robot's name is a setting.
  void on_names(RobotNames names, TimePoint now);

  void on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint now);
  /// Answered with the outcome "refused" when the robot is on this link.
  void on_broker_message(const RobotMessage& message, TimePoint now);
  void on_subscribe_result(const std::string& robot, const std::string& filter, bool granted,
                           TimePoint now);
  /// As MeshAdapter; no command waits.
  std::vector<WaitingMessage> give_up(const std::string& robot, TimePoint now);
  void on_broker_link(bool is_up, TimePoint now);
  void on_trace(bool) {}      // no command is sent, and acknowledgements are not traced here
  void on_stop(TimePoint) {}  // no command waits

  std::optional<CobsAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);
  std::optional<Presence> presence_of(std::string_view robot) const;
  std::size_t queued_for(std::string_view) const { return 0; }
  Counters counters() const;

 private:
  /// A robot. Keyed by its Lien address, of which there are 255; with positions there is one.
  struct Peer {
    std::string id;
    std::string address;  ///< for people
    bool is_online = false;
    TimePoint last_heard{};
    bool is_subscribed = true;  ///< false: the broker refused it; asked again later
    LienConnection connection = {};
    std::uint64_t open_receipt = 0;  ///< 0: none
  };

  void on_frame(const Bytes& encoded, TimePoint now);
  void on_lien_frame(const LienFrame& frame, TimePoint now);
  void on_lien_message(Peer& peer, ByteView message, std::uint64_t receipt_id);
  void add_configured(bool is_start);
  Peer& lien_peer(std::uint8_t address);
  void on_heard(Peer& peer, TimePoint now);
  void reply(std::uint8_t address, const Bytes& data);
  void report(const Peer& peer, std::string_view type, ByteView payload, std::uint64_t receipt_id);
  void reject(std::string_view why, TimePoint now);
  /// `is_here`: counts as a sign that the robot is here, and not at another gateway.
  void subscribe(const Peer& peer, bool is_here);
  void emit(MeshEvent event) { actions_.push(std::move(event)); }

  Settings settings_;
  TopicScheme topics_;
  RobotNames names_;
  ActionQueue<CobsAction> actions_;
  CobsSplitter splitter_;
  bool is_up_ = false;
  std::string down_reason_;
  std::map<std::uint8_t, Peer> peers_;
  std::map<std::uint64_t, std::uint8_t> open_receipts_;  ///< at most one for each peer
  std::uint64_t last_receipt_ = 0;
  std::uint64_t reports_ = 0;
  std::uint64_t rejected_ = 0;
  LogThrottle reject_throttle_;
};

}  // namespace slamgw::ble
