// SPDX-License-Identifier: Apache-2.0
// This gateway among others: the shell around fleet::Ownership. Hands it what meshes and broker
// say, and does what it decides.
#pragma once

#include <boost/asio/io_context.hpp>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "daemon/app/fleet_memory.hpp"
#include "daemon/app/meshes.hpp"
#include "daemon/config/config.hpp"
#include "daemon/core/gateway.hpp"
#include "daemon/fleet/ownership.hpp"
#include "daemon/mqtt/upstream.hpp"
#include "daemon/runtime/machine_driver.hpp"

namespace slamgw {

class FleetMember {
 public:
  /// Through the outbox.
  using Submit = std::function<void(BrokerMessage)>;

  /// All of them outlive it.
  FleetMember(boost::asio::io_context& io, const Config& config, Gateway& gateway,
              MachineDriver<Gateway>& gateway_driver, Meshes& meshes, Upstream& upstream,
              Submit submit);

  void on_broker_link(bool is_up, bool is_session_kept);
  void on_subscribe_result(const std::string& filter, SubscribeAnswer answer);
  void on_mesh_event(const MeshEvent& event);
  void perform(AwaitTurn& action);
  void perform(AskAboutRobot& action);
  void perform(RobotForgotten& action);
  void report_outcome(Upload& action);
  bool may_be_shared() const { return ownership_.may_be_shared(); }
  /// Its messages do not go through the outbox.
  static bool is_own(std::uint64_t sequence) { return sequence >= first_sequence; }
  /// The broker has acknowledged one of them, or does not take it.
  void on_published(std::uint64_t sequence);
  void on_publish_refused(std::uint64_t sequence);
  /// For `slam-gatewayctl fleet`: this gateway first.
  nlohmann::ordered_json status(const Now& now) const;
  std::vector<MissingRight> missing_rights(TimePoint now) const {
    return ownership_.missing_rights(now);
  }
  Counters counters() const { return ownership_.counters(); }
  /// Before the outbox ends.
  void on_stop();
  void stop();

 private:
  static constexpr std::uint64_t first_sequence = std::uint64_t{1} << 63U;
  /// Of outcomes: theirs is the sum of this and PublishOutcomeNow::id.
  static constexpr std::uint64_t first_outcome = first_sequence + (first_sequence >> 1U);

  bool is_alone() const { return ownership_.is_alone(); }
  bool takes(const BrokerMessage& message);
  std::vector<fleet::LocalRobot> local_robots() const;
  void on_heard_too(const std::string& robot, const std::optional<RadioFacts>& radio);
  const char* state(TimePoint now) const;
  nlohmann::ordered_json gateways(const Now& now) const;
  nlohmann::ordered_json robots(const Now& now) const;
  void perform(fleet::PublishNow& action);
  void perform(fleet::AnnounceGateway& action);
  void perform(fleet::RememberOthers& action);
  void perform(fleet::SubscribeFleet& action);
  void perform(fleet::UnsubscribeFleet& action);
  void perform(fleet::TakeOverRobot& action);
  void perform(fleet::GiveUpRobot& action);
  void perform(fleet::CarryOut& action);
  void perform(fleet::EndCommand& action);
  void perform(fleet::PublishOutcomeNow& action);
  void perform(fleet::PublishOutcome& action);
  void perform(fleet::PublishWill& action);
  void perform(Notice& notice);

  Gateway& gateway_;
  MachineDriver<Gateway>& gateway_driver_;
  Meshes& meshes_;
  Upstream& upstream_;
  Submit submit_;
  const WallTime started_;
  FleetMemory memory_;
  fleet::Ownership ownership_;
  MachineDriver<fleet::Ownership> driver_;
  std::uint64_t next_sequence_ = first_sequence;
};

}  // namespace slamgw
