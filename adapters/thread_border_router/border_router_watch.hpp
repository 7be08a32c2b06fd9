// SPDX-License-Identifier: Apache-2.0
// Decides when to ask the Thread border router of this host (otbr-agent of ot-br-posix) about its
// mesh, and when to publish the answer as `<prefix>/gateway/<gw>/thread` (docs/topics.md). No
// robot's message passes here. Pure; driven by io/BorderRouter.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "daemon/core/messages.hpp"
#include "daemon/core/protocol_machine.hpp"

namespace slamgw::border_router {

/// A node that otbr-agent hears itself: an entry of NeighborTable, which lists children, too.
struct Neighbour {
  /// OpenThread's word for "not measured".
  static constexpr std::int8_t no_rssi = 127;

  std::uint64_t extended_address = 0;
  std::uint16_t rloc16 = 0;
  std::uint8_t link_quality = 0;  ///< 0 to 3, of the frames from it
  std::int8_t rssi_average_dbm = no_rssi;
  std::int8_t rssi_last_dbm = no_rssi;
  std::uint16_t frame_errors = 0;  ///< 0xffff: each frame to it fails
  bool is_always_on = false;       ///< its receiver is always on: it does not sleep
  bool is_child = false;
};

/// The answers of otbr-agent. A member stays empty after an error or a value of another type.
struct NodeFacts {
  /// A node has at most 31 routers beside it, and otbr-agent some dozens of children. The document
  /// stays below the 64 KiB that the live page takes.
  static constexpr std::size_t max_neighbours = 256;

  std::optional<std::string> role{};
  std::optional<std::string> network_name{};
  std::optional<std::uint16_t> channel{};
  std::optional<std::uint16_t> rloc16{};
  std::optional<std::uint64_t> extended_address{};
  std::optional<std::uint32_t> partition_id{};
  std::optional<std::uint8_t> leader_router_id{};
  std::optional<std::vector<Neighbour>> neighbours{};  ///< at most max_neighbours
  std::uint64_t left_out = 0;                          ///< neighbours beyond max_neighbours
  std::string problem{};                               ///< a problem for the operator; may be empty
};

/// Ask otbr-agent; the answer is on_read().
struct ReadNode {};
/// Publish the document retained; empty: remove it.
struct PublishDocument {
  std::string json;
};
using WatchAction = std::variant<ReadNode, PublishDocument, Notice>;

class BorderRouterWatch {
 public:
  static constexpr std::chrono::seconds interval{10};
  /// Delay from a change that otbr-agent reports to the next reading.
  static constexpr std::chrono::seconds settling{1};

  /// Publishes the document again after each connection to the broker.
  void on_broker_link(bool is_up);
  /// Call when otbr-agent is on the bus.
  void on_came(TimePoint now) { read_at_ = now; }
  /// Call when otbr-agent is not on the bus, or has left it.
  void on_gone();
  /// Call when otbr-agent reports a change, such as its role.
  void on_changed(TimePoint now);
  /// Answers ReadNode.
  void on_read(NodeFacts facts, TimePoint now);

  std::optional<WatchAction> next_action() { return actions_.pop(); }
  std::optional<TimePoint> deadline() const { return read_at_; }
  void on_deadline(const Now& now);

  /// `disabled`, `detached`, `child`, `router` or `leader`; empty: not known.
  const std::string& role() const { return role_; }

 private:
  void publish();

  ActionQueue<WatchAction> actions_;
  bool is_broker_up_ = false;
  std::optional<TimePoint> read_at_;  ///< nothing while otbr-agent is read, or is not there
  std::string role_;
  bool is_announced_ = false;  ///< the log says that otbr-agent is there
  std::string problem_;        ///< the last one in the log
  // Nothing: not known yet. Empty: there is no otbr-agent.
  std::optional<std::string> document_;
  std::optional<std::string> published_;  ///< over this connection to the broker
};

}  // namespace slamgw::border_router
