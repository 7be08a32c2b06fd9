// SPDX-License-Identifier: Apache-2.0
// An operator's orders for the BLE mesh and its robots (`slam-gatewayctl ble ...`), and the answer.
// Plain values between the control socket and a mesh's machine. An imported mesh holds keys, so it
// is never logged and never in an answer.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <variant>
#include <vector>

namespace slamgw {

/// Lists devices in reach that are in no mesh. Takes about ten seconds.
struct ScanOrder {};
struct ProvisionOrder {
  std::string uuid;   ///< 32 hex digits, hyphens allowed
  std::string robot;  ///< the new robot's name
};
/// Allows robots to join for a while, whatever the configuration says; 0 seconds ends that.
/// Answered at once, with the same document as JoinEventsOrder.
struct PermitJoinOrder {
  static constexpr std::chrono::hours longest{24};  ///< a longer time is cut to this
  std::chrono::seconds time{0};
  std::string robot;  ///< only one robot may join, and gets this name; empty: all may join

  /// `5 min`, `90 s`, `closed`
  std::string time_words() const {
    constexpr std::chrono::minutes minute{1};
    if (time == time.zero()) return "closed";
    return time % minute == time.zero() ? std::to_string(time / minute) + " min"
                                        : std::to_string(time.count()) + " s";
  }
};
/// Asks which robots have joined. The answer has the time left, and the events numbered above
/// `after`.
struct JoinEventsOrder {
  std::uint64_t after = 0;
};
struct NodesOrder {};
struct RemoveOrder {
  std::string robot;
  bool is_forced = false;  ///< removes the robot even if it does not answer
};
struct ImportOrder {
  std::string text;  ///< a mesh database
};
/// Asks a robot of the mesh for its default TTL, once.
struct PingOrder {
  std::string robot;
};
/// How often a node sends each packet, and at which interval.
struct Transmissions {
  std::uint8_t sends = 1;          ///< 1 to 8
  std::uint16_t interval_ms = 10;  ///< 10 to 320, a multiple of 10
  bool operator==(const Transmissions&) const = default;

  static constexpr bool is_valid(std::uint64_t sends, std::uint64_t interval_ms) {
    return sends >= 1 && sends <= 8 && interval_ms >= 10 && interval_ms <= 320 &&
           interval_ms % 10 == 0;
  }
};
/// Changes the operator's settings for one robot, and reads the configuration of its node.
struct NodeConfigOrder {
  /// Outer nothing: no change. Inner nothing: the same value as all other robots. Otherwise, a
  /// value for this robot alone.
  template <class Value>
  using Wish = std::optional<std::optional<Value>>;

  std::string robot;
  Wish<std::uint8_t> ttl = {};
  Wish<bool> relay = {};
  Wish<Transmissions> transmit = {};
  std::optional<std::uint16_t> subscribe = {};    ///< to this group, besides those of all robots
  std::optional<std::uint16_t> unsubscribe = {};  ///< from a group that `subscribe` added
  struct Publication {
    std::string model;                     ///< its name or its id, as `ble config` shows them
    std::optional<std::uint16_t> address;  ///< nothing: the same as all other robots

    /// True for a unicast address or a group.
    static constexpr bool is_valid(std::uint64_t address) {
      return (address >= 0x0001 && address <= 0x7fff) || (address >= 0xc000 && address <= 0xfeff);
    }
  };
  std::optional<Publication> publish = {};

  bool is_change() const { return ttl || relay || transmit || subscribe || unsubscribe || publish; }
};
/// Exports what another gateway needs to join this mesh with a board of its own. Answer:
/// `{"address", "mesh"}`, the other gateway's unicast address and its mesh database as text. No
/// other answer holds keys.
struct ExportOrder {
  std::uint16_t address = 0;  ///< the other gateway's present address; 0: it gets a new one
};
/// Erases the board for good and starts it again.
struct ResetBoardOrder {};
/// Gives all robots of the mesh new keys, or asks for the progress of that.
struct RefreshKeysOrder {
  std::vector<std::string> left_behind = {};  ///< robots that get no keys, and so leave the mesh
  bool leaves_silent = false;  ///< also leaves behind robots that did not take their keys
  bool is_question = false;
};

/// Measures which robots hear each other, or asks for the progress of that.
struct MeasureHearingOrder {
  bool is_question = false;
};

using BleOrder = std::variant<ScanOrder, ProvisionOrder, PermitJoinOrder, JoinEventsOrder,
                              NodesOrder, RemoveOrder, PingOrder, NodeConfigOrder, ImportOrder,
                              ExportOrder, ResetBoardOrder, RefreshKeysOrder, MeasureHearingOrder>;

/// Either a JSON document or, when the order was refused or failed, a sentence.
struct OrderAnswer {
  std::string json;
  std::string error;
};
/// Takes the answer; called once.
using OrderDone = std::function<void(OrderAnswer)>;

// An operator's orders for dead letters (`slam-gatewayctl store ...`), the messages that the broker
// did not take. Plain values between the control socket and the message store; answered like orders
// about a mesh (OrderDone).

/// Selects dead letters: those with these ids, or of this topic, or all.
struct DeadLetterChoice {
  std::vector<std::uint64_t> ids;
  std::string topic;
  bool is_all = false;
};

/// Lists a page of dead letters, by rising id. Answer: `{"count", "bytes", "letters": [...],
/// "more"}`; `count` and `bytes` are of all dead letters.
struct ListDeadLetters {
  std::uint64_t after = 0;  ///< the last id of the page before
  std::string topic;        ///< empty: any
  bool with_payloads = false;
};
/// Puts the chosen letters back among the undelivered messages, before later ones, oldest first.
/// Damaged letters are lost. Answer: `{"resent", "left"}`.
struct ResendOrder {
  DeadLetterChoice choice;
};
/// Deletes the chosen letters. Answer: `{"discarded"}`.
struct DiscardOrder {
  DeadLetterChoice choice;
};

using StoreOrder = std::variant<ListDeadLetters, ResendOrder, DiscardOrder>;

}  // namespace slamgw
