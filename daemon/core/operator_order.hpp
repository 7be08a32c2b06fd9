// SPDX-License-Identifier: Apache-2.0
// What an operator wants done to the BLE mesh and its robots (`slam-gatewayctl ble ...`), and the
// answer. Plain values between the control socket and a mesh's machine. An imported mesh holds
// keys: never logged, never in an answer.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <variant>
#include <vector>

namespace slamgw {

/// Devices in reach that are in no mesh. Takes about ten seconds.
struct ScanOrder {};
struct ProvisionOrder {
  std::string uuid;   ///< 32 hex digits, hyphens allowed
  std::string robot;  ///< its name from then on
};
/// Allows robots to join for a while, whatever the configuration says; 0 seconds ends that.
/// Answered at once, in the form of JoinEventsOrder.
struct PermitJoinOrder {
  static constexpr std::chrono::hours longest{24};  ///< more is as much
  std::chrono::seconds time{0};
  std::string robot;  ///< the one that may join gets this name; empty: all may

  /// `5 min`, `90 s`, `closed`
  std::string time_words() const {
    constexpr std::chrono::minutes minute{1};
    if (time == time.zero()) return "closed";
    return time % minute == time.zero() ? std::to_string(time / minute) + " min"
                                        : std::to_string(time.count()) + " s";
  }
};
/// Asks who has joined: the answer has the time left, and the events numbered above `after`.
struct JoinEventsOrder {
  std::uint64_t after = 0;
};
struct NodesOrder {};
struct RemoveOrder {
  std::string robot;
  bool is_forced = false;  ///< forget it even if it does not answer
};
struct ImportOrder {
  std::string text;  ///< a mesh database
};
/// Asks a robot of the mesh for its default TTL, once.
struct PingOrder {
  std::string robot;
};
/// How often a node sends each packet, and how far apart.
struct Transmissions {
  std::uint8_t sends = 1;          ///< 1 to 8
  std::uint16_t interval_ms = 10;  ///< 10 to 320, a multiple of 10
  bool operator==(const Transmissions&) const = default;

  static constexpr bool is_valid(std::uint64_t sends, std::uint64_t interval_ms) {
    return sends >= 1 && sends <= 8 && interval_ms >= 10 && interval_ms <= 320 &&
           interval_ms % 10 == 0;
  }
};
/// Changes what the operator wants of one robot, and reads what its node is configured with.
struct NodeConfigOrder {
  /// A value for this robot alone; nothing: as all others have it.
  template <class Value>
  using Wish = std::optional<std::optional<Value>>;

  std::string robot;
  Wish<std::uint8_t> ttl = {};
  Wish<bool> relay = {};
  Wish<Transmissions> transmit = {};
  std::optional<std::uint16_t> subscribe = {};    ///< to this group, beside those of all robots
  std::optional<std::uint16_t> unsubscribe = {};  ///< from one of these
  struct Publication {
    std::string model;                     ///< its name or its id, as `ble config` shows them
    std::optional<std::uint16_t> address;  ///< nothing: as all others have it

    /// A unicast address or a group.
    static constexpr bool is_valid(std::uint64_t address) {
      return (address >= 0x0001 && address <= 0x7fff) || (address >= 0xc000 && address <= 0xfeff);
    }
  };
  std::optional<Publication> publish = {};

  bool is_change() const { return ttl || relay || transmit || subscribe || unsubscribe || publish; }
};
/// What another gateway needs to join this mesh with a board of its own: `{"address", "mesh"}`, the
/// unicast address that it gets, and its mesh database as text. The one answer that holds keys.
struct ExportOrder {
  std::uint16_t address = 0;  ///< that the other gateway has already; 0: it gets a new one
};
/// Clears the board for good and starts it up anew.
struct ResetBoardOrder {};
/// Gives all robots of the mesh new keys, or asks how far that has come.
struct RefreshKeysOrder {
  std::vector<std::string> left_behind = {};  ///< robots that get none, and are out of the mesh
  bool leaves_silent = false;                 ///< those that did not take theirs, too
  bool is_question = false;
};

/// Measures which robots hear which, or asks how far that has come.
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
/// Called once.
using OrderDone = std::function<void(OrderAnswer)>;

// What an operator wants done with dead letters (`slam-gatewayctl store ...`): messages that were
// dead letters because the broker did not take them. Plain values between the control socket and
// the message store; answered as orders about a mesh are (OrderDone).

/// Which dead letters are meant: those with these ids, or of this topic, or all.
struct DeadLetterChoice {
  std::vector<std::uint64_t> ids;
  std::string topic;
  bool is_all = false;
};

/// A page of them, by rising id. Answer: `{"count", "bytes", "letters": [...], "more"}`; `count`
/// and `bytes` are of all.
struct ListDeadLetters {
  std::uint64_t after = 0;  ///< the last id of the page before
  std::string topic;        ///< empty: any
  bool with_payloads = false;
};
/// Puts them back among the undelivered messages, behind the others, oldest first; damaged ones
/// only when their ids are named. Answer: `{"resent", "left"}`.
struct ResendOrder {
  DeadLetterChoice choice;
};
/// Deletes them. Answer: `{"discarded"}`.
struct DiscardOrder {
  DeadLetterChoice choice;
};

using StoreOrder = std::variant<ListDeadLetters, ResendOrder, DiscardOrder>;

}  // namespace slamgw
