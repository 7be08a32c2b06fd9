// SPDX-License-Identifier: Apache-2.0
// The common part of every mesh's shell: passes the core's calls to the machine, and answers
// questions from its state. A mesh's own shell adds its sockets or port, and performs the machine's
// actions.
#pragma once

#include <concepts>
#include <string>

#include "daemon/core/adapter.hpp"
#include "daemon/core/protocol_machine.hpp"
#include "daemon/runtime/machine_driver.hpp"

namespace slamgw {

/// A protocol machine that speaks for the robots of one mesh. Each input is that of MeshAdapter.
template <class Machine>
concept MeshProtocolMachine = ProtocolMachine<Machine> &&
    requires(Machine& machine, const Machine& unchanged, const RobotMessage& message,
             const std::string& text, const Now& now) {
  machine.on_receipt(std::uint64_t{}, ReceiptOutcome{}, now);
  machine.on_broker_message(message, now);
  machine.on_subscribe_result(text, text, bool{}, now);
  machine.on_broker_link(bool{}, now);
  machine.on_trace(bool{});
  machine.on_stop(now);
  { unchanged.presence_of(text) } -> std::same_as<std::optional<Presence>>;
  { unchanged.queued_for(text) } -> std::same_as<std::size_t>;
  { unchanged.counters() } -> std::same_as<Counters>;
};

template <MeshProtocolMachine Machine>
class MeshShell : public MeshAdapter {
 public:
  void on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome) final {
    driver()->on_receipt(receipt_id, outcome, read_clocks());
  }
  void on_broker_message(const RobotMessage& message) final {
    driver()->on_broker_message(message, read_clocks());
  }
  void on_subscribe_result(const std::string& robot, const std::string& filter,
                           bool granted) final {
    driver()->on_subscribe_result(robot, filter, granted, read_clocks());
  }
  void on_broker_link(bool is_up) final { driver()->on_broker_link(is_up, read_clocks()); }
  void trace(bool is_on) final { driver()->on_trace(is_on); }
  void stop_listening() override { driver()->on_stop(read_clocks()); }
  std::optional<Presence> presence_of(const std::string& robot) const final {
    return driver().machine().presence_of(robot);
  }
  std::size_t queued_for(const std::string& robot) const final {
    return driver().machine().queued_for(robot);
  }
  Counters counters() const override { return driver().machine().counters(); }

 protected:
  virtual MachineDriver<Machine>& driver() = 0;
  virtual const MachineDriver<Machine>& driver() const = 0;
};

}  // namespace slamgw
