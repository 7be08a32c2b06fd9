// SPDX-License-Identifier: Apache-2.0
// What an operator wants done to a mesh and its robots (`slam-gatewayctl ble ...`), and the answer.
// Plain values between the control socket and a mesh's machine. An imported mesh holds keys: never
// logged, never in an answer.
#pragma once

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
struct NodesOrder {};
struct RemoveOrder {
  std::string robot;
  bool is_forced = false;  ///< forget it even when it does not answer
};
struct ImportOrder {
  std::string text;  ///< a mesh database
};
/// Clears the board for good and starts it up anew.
struct ResetBoardOrder {};

using MeshOrder =
    std::variant<ScanOrder, ProvisionOrder, NodesOrder, RemoveOrder, ImportOrder, ResetBoardOrder>;

/// Either a JSON document or, when the order was refused or failed, a sentence.
struct OrderAnswer {
  std::string json;
  std::string error;
};
/// Called once.
using OrderDone = std::function<void(OrderAnswer)>;

}  // namespace slamgw
