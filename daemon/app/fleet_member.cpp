// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/fleet_member.hpp"

#include <random>
#include <utility>

#include "daemon/observability/log.hpp"

namespace slamgw {

using fleet::Ownership;
using Json = nlohmann::ordered_json;

namespace {

fleet::Settings settings_of(const Config& config, const FleetMemory& memory) {
  std::random_device random;
  return {config.fleet, (std::uint64_t{random()} << 32U) | random(), memory.were_others_about()};
}

}  // namespace

FleetMember::FleetMember(boost::asio::io_context& io, const Config& config, Gateway& gateway,
                         MachineDriver<Gateway>& gateway_driver, Meshes& meshes, Upstream& upstream,
                         Submit submit)
    : gateway_(gateway),
      gateway_driver_(gateway_driver),
      meshes_(meshes),
      upstream_(upstream),
      submit_(std::move(submit)),
      started_(read_clocks().wall),
      memory_(config.store.directory),
      ownership_({config.topics.prefix, config.gateway_id}, settings_of(config, memory_),
                 [this] { return local_robots(); }),
      driver_(io, ownership_, [this](fleet::OwnershipAction& action) {
        std::visit([this](auto& what) { perform(what); }, action);
      }) {
  // Before there is a broker. So the core asks none for the robots' own subscriptions to commands,
  // of which a restarted gateway has many, before Ownership asks for all commands.
  if (config.fleet != fleet::Enabled::no)
    gateway_.subscribe_own(
        TopicScheme(config.topics.prefix, config.gateway_id).command_topic("+", "+"));
  gateway_.share_with(
      {[this] { return ownership_.is_shared() || ownership_.may_be_shared(); },
       [this] { return !ownership_.is_alone() && upstream_.version() == MqttVersion::v3_1_1; },
       [this](const std::string& robot) {
         return ownership_.speaks_for(robot, read_clocks().mono);
       },
       [this](const std::string& robot, Presence presence, bool has_just_come) {
         return ownership_.may_announce(robot, presence, has_just_come, read_clocks().mono);
       },
       [this](const BrokerMessage& message) { return takes(message); }});
  meshes_.ask_where_served([this](const std::string& robot) {
    return !ownership_.speaks_for(robot, read_clocks().mono);
  });
  meshes_.share_ble(
      [this](const std::string& robot) { return ownership_.may_serve(robot, read_clocks().mono); },
      [this](const std::string& robot, const std::optional<RadioFacts>& radio) {
        on_heard_too(robot, radio);
      });
}

std::vector<fleet::LocalRobot> FleetMember::local_robots() const {
  std::vector<fleet::LocalRobot> local;
  for (const auto& [id, robot] : gateway_.registry().robots()) {
    if (robot.presence().is_known)
      local.push_back({id, robot.presence().presence != Presence::offline});
  }
  return local;
}

void FleetMember::on_broker_link(bool is_up, bool is_session_kept) {
  driver_.input([&](auto& ownership, const Now& now) {
    ownership.on_broker_link(is_up, now, is_session_kept);
  });
}

void FleetMember::on_stop() { driver_.input(&Ownership::on_stop); }

void FleetMember::on_subscribe_result(const std::string& filter, SubscribeAnswer answer) {
  driver_.input(&Ownership::on_subscribe_result, filter, answer);
}

bool FleetMember::takes(const BrokerMessage& message) {
  bool is_taken = false;
  driver_.input([&](auto& ownership, const Now& now) {
    is_taken = ownership.on_broker_message(message, now);
  });
  return is_taken;
}

/// What was heard in a shared mesh comes to on_heard_too().
void FleetMember::on_mesh_event(const MeshEvent& event) {
  const auto* link = std::get_if<LinkChange>(&event);
  if (link && meshes_.is_shared(link->mesh)) driver_.input(&Ownership::on_board, link->is_up);
  if (ownership_.is_alone() && !ownership_.is_holding_wills()) return;
  const std::string* heard = nullptr;
  if (const auto* sign = std::get_if<SignOfLife>(&event); sign && !meshes_.is_shared(sign->mesh))
    heard = &sign->robot;
  if (const auto* report = std::get_if<Report>(&event);
      report && !report->is_will && !meshes_.is_shared(report->mesh))
    heard = &report->robot;
  if (heard) driver_.input(&Ownership::on_heard, *heard);
}

/// The mesh may be shared since just now, and the link have come up before.
void FleetMember::on_heard_too(const std::string& robot, const std::optional<RadioFacts>& radio) {
  std::optional<fleet::SignalLevel> level;
  if (radio)
    level = fleet::SignalLevel{radio->rssi_dbm -
                               fleet::SignalLevel::relay_cost_db * radio->hops.value_or(0)};
  driver_.input(&Ownership::on_board, true);
  driver_.input(&Ownership::on_heard_too, robot, level);
}

/// Until this gateway is a member, the broker may still have a subscription of the robot itself.
void FleetMember::perform(AwaitTurn& action) {
  const bool may_be_copy = upstream_.version() == MqttVersion::v3_1_1 &&
                           gateway_.registry().find(action.robot) != nullptr;
  driver_.input([&](auto& ownership, const Now& now) {
    ownership.on_command(std::move(action.message), std::move(action.robot), std::move(action.type),
                         now, may_be_copy);
  });
}

void FleetMember::perform(AskAboutRobot& action) {
  driver_.input(&Ownership::on_will, std::move(action.will));
}

void FleetMember::perform(RobotForgotten& action) {
  driver_.input(&Ownership::on_forgotten, action.robot);
}

void FleetMember::report_outcome(Upload& action) {
  driver_.input(&Ownership::on_own_outcome, std::move(action.message), *action.outcome_after);
}

void FleetMember::perform(fleet::PublishNow& action) {
  upstream_.publish(next_sequence_++, std::move(action.message));
}

void FleetMember::perform(fleet::AnnounceGateway&) {
  gateway_driver_.input(&Gateway::publish_state);
}

void FleetMember::perform(fleet::RememberOthers& action) { memory_.remember(action.are_about); }

void FleetMember::stop() {
  driver_.stop();
  memory_.stop();
}

/// The core keeps it over reconnects, and knows about copies.
void FleetMember::perform(fleet::SubscribeFleet& action) {
  gateway_driver_.input(&Gateway::subscribe_own, action.filter);
}

void FleetMember::perform(fleet::UnsubscribeFleet& action) {
  gateway_driver_.input(&Gateway::unsubscribe_own, action.filter);
}

void FleetMember::perform(fleet::TakeOverRobot& action) {
  meshes_.take_over(action.robot, action.session);
  gateway_driver_.input(&Gateway::on_taken_over, action.robot, action.dead_owner);
}

void FleetMember::perform(fleet::GiveUpRobot& action) {
  Bytes session = meshes_.give_up(action.robot);
  gateway_driver_.input(&Gateway::on_given_up, action.robot);
  if (action.is_awaited)
    driver_.input(&Ownership::on_given_up, action.robot, action.to, std::move(session));
}

void FleetMember::perform(fleet::CarryOut& action) {
  gateway_driver_.input(&Gateway::on_turn, std::move(action.command));
}

void FleetMember::perform(fleet::EndCommand& action) {
  const auto after = std::chrono::duration_cast<std::chrono::milliseconds>(action.after);
  gateway_driver_.input(&Gateway::on_ended_elsewhere,
                        CommandOutcome{std::nullopt, CommandId::none, action.robot, action.type,
                                       action.result, after, action.why});
}

void FleetMember::perform(fleet::PublishOutcomeNow& action) {
  upstream_.publish(first_outcome + action.id, action.message);
}

void FleetMember::on_published(std::uint64_t sequence) {
  if (sequence < first_outcome) return;
  driver_.input(&Ownership::on_outcome_acknowledged, sequence - first_outcome);
}

void FleetMember::on_publish_refused(std::uint64_t sequence) {
  if (sequence < first_outcome) return;
  driver_.input(&Ownership::on_outcome_refused, sequence - first_outcome);
}

void FleetMember::perform(fleet::PublishOutcome& action) { submit_(std::move(action.message)); }

void FleetMember::perform(fleet::PublishWill& action) {
  gateway_driver_.input(&Gateway::on_silence, std::move(action.will));
}

void FleetMember::perform(Notice& notice) { log_notice(notice); }

// --- For operators -------------------------------------------------------------------------------

const char* FleetMember::state(TimePoint now) const {
  using Phase = Ownership::Phase;
  switch (ownership_.phase()) {
    case Phase::alone: return "alone";
    case Phase::joining: return "joining";
    case Phase::member: return ownership_.is_leased(now) ? "member" : "cut off";
  }
  return "";
}

/// This gateway, those whose beats were heard, and those that are on the broker without beats.
Json FleetMember::gateways(const Now& now) const {
  const auto& states = ownership_.states();
  const auto& peers = ownership_.peers();
  const auto row = [&](const std::string& id, const char* state, std::uint64_t robots) {
    Json gateway{{"gateway", id}, {"state", state}, {"robots", robots}};
    if (const auto known = states.find(id); known != states.end()) {
      gateway["version"] = known->second.version;
      gateway["since"] = known->second.since;
    }
    return gateway;
  };
  const auto local = local_robots();
  Json own =
      row(ownership_.name(), state(now.mono), is_alone() ? local.size() : ownership_.owned());
  own["version"] = SLAMGW_VERSION;
  own["since"] = to_iso8601(started_);
  Json rows = Json::array({std::move(own)});
  for (const auto& [id, peer] : peers.all())
    rows.push_back(row(id, peers.is_alive(id, now.mono) ? "member" : "silent", peer.digest.count));
  for (const auto& each : states)
    if (!peers.find(each.first)) rows.push_back(row(each.first, "apart", 0));
  return rows;
}

/// `since`: when this gateway learned that the robot is there.
Json FleetMember::robots(const Now& now) const {
  Json rows = Json::array();
  const auto add = [&](const std::string& robot, const std::string& gateway, WallTime since,
                       bool is_served) {
    rows.push_back({{"robot", robot},
                    {"gateway", gateway},
                    {"since", to_iso8601(since)},
                    {"served", is_served}});
  };
  if (is_alone()) {
    for (const auto& [id, robot] : gateway_.registry().robots())
      if (robot.presence().is_known) add(id, ownership_.name(), robot.presence().since, true);
  }
  for (const auto& [robot, row] : ownership_.claims().rows()) {
    const auto place = ownership_.place_of(robot, now.mono);
    add(robot, place->gateway, place->since, place->is_alive);
  }
  return rows;
}

Json FleetMember::status(const Now& now) const {
  return {{"gateway", ownership_.name()},
          {"lease_lapses", ownership_.lease_lapses()},
          {"gateways", gateways(now)},
          {"robots", robots(now)}};
}

}  // namespace slamgw
