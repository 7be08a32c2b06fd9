// SPDX-License-Identifier: Apache-2.0
// Follows each message from its arrival to its acknowledgement and each command to its outcome:
// joins what the core, the meshes and delivery report into one stream of TraceEvents. Pure. While
// it is off, each call costs one test of a flag.
#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include "daemon/core/topic_scheme.hpp"
#include "daemon/core/traffic_event.hpp"

namespace slamgw {

/// A step as `slam-gatewayctl watch` shows it. Values only; daemon/control/wire writes the JSON.
struct TraceEvent : MessageStep {
  WallTime at{};
  std::string type{};
  /// Time since the message arrived, or the command came.
  std::optional<std::chrono::microseconds> latency{};
  std::optional<CommandResult> outcome{};
  std::optional<Update> update{};
  bool had_stray_octet = false;    ///< after the update
  std::optional<Bytes> payload{};  ///< of `arrived` and `command`
};

class Trace {
 public:
  /// Messages and commands that are followed at once. The oldest is forgotten first; its later
  /// events lack the facts that were known only on its arrival.
  static constexpr std::size_t max_followed = 65536;

  using Sink = std::function<void(const TraceEvent&)>;
  /// Returns the robot's address on this mesh; empty when it is not known.
  using AddressOf = std::function<std::string(const std::string& robot, Mesh mesh)>;

  Trace(TopicScheme scheme, AddressOf address_of, Sink sink)
      : scheme_(std::move(scheme)), address_of_(std::move(address_of)), sink_(std::move(sink)) {}

  /// Turns the trace on or off, and forgets everything followed before.
  void turn(bool is_on);
  std::size_t followed() const { return followed_.size(); }

  void on_traffic(const TrafficEvent& event);
  /// Takes a step of a mesh or of the outbox.
  void on_step(const MessageStep& step, const Now& now);
  void on_outcome(const CommandOutcome& outcome, const Now& now);

 private:
  /// The facts of a message that are known only at its arrival.
  struct Followed {
    std::string robot;
    std::string topic;
    std::string type;
    Qos qos = Qos::at_most_once;
    WireFacts wire;
    std::size_t bytes = 0;
    TimePoint at{};
  };
  /// Identifies a receipt of a mesh, or a command.
  using Key = std::pair<std::size_t, std::uint64_t>;

  static Key key_of(const Receipt& receipt) { return {index_of(receipt.mesh), receipt.id}; }
  static Key key_of(CommandId command);
  void follow(const Key& key, const TrafficEvent& event);
  const Followed* find(const Key& key) const;
  /// Fills in the fields that the step leaves out.
  void complete(TraceEvent& event, const Followed* followed, TimePoint now) const;
  void emit(TraceEvent event);

  TopicScheme scheme_;
  AddressOf address_of_;
  Sink sink_;
  bool is_on_ = false;
  std::map<Key, Followed> followed_;
  std::deque<Key> order_;  ///< by arrival; at most max_followed; some may have ended
};

}  // namespace slamgw
