// SPDX-License-Identifier: Apache-2.0
// What an operator wants done to the BLE mesh and its robots (`slam-gatewayctl ble ...`), and the
// answer. Plain values between the control socket and a mesh's machine. An imported mesh holds
// keys: never logged, never in an answer.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <string>
#include <variant>

namespace slamgw {

/// Devices in reach that are in no mesh. Takes about ten seconds.
struct ScanOrder {};
struct ProvisionOrder {
  std::string uuid;   ///< 32 hex digits, hyphens allowed
  std::string robot;  ///< its name from then on
};
/// Allows robots to join for a while, whatever the configuration says; 0 minutes ends that.
/// Answered at once, in the form of JoinEventsOrder.
struct PermitJoinOrder {
  std::chrono::minutes time{0};
  std::string robot;  ///< the one that may join gets this name; empty: all may
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
/// What another gateway needs to join this mesh with a board of its own: `{"address", "mesh"}`, the
/// unicast address that it gets, and its mesh database as text. The one answer that holds keys.
struct ExportOrder {
  std::uint16_t address = 0;  ///< that the other gateway has already; 0: it gets a new one
};
/// Clears the board for good and starts it up anew.
struct ResetBoardOrder {};

using BleOrder = std::variant<ScanOrder, ProvisionOrder, PermitJoinOrder, JoinEventsOrder,
                              NodesOrder, RemoveOrder, ImportOrder, ExportOrder, ResetBoardOrder>;

/// Either a JSON document or, when the order was refused or failed, a sentence.
struct OrderAnswer {
  std::string json;
  std::string error;
};
/// Called once.
using OrderDone = std::function<void(OrderAnswer)>;

}  // namespace slamgw
