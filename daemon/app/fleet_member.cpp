// SPDX-License-Identifier: Apache-2.0
#include "daemon/app/fleet_member.hpp"

#include <nlohmann/json.hpp>

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "daemon/core/result.hpp"
#include "daemon/observability/log.hpp"
#include "daemon/sessions/session_names.hpp"

namespace slamgw {

using sessions::RobotSessions;
using Json = nlohmann::ordered_json;

FleetMember::FleetMember(boost::asio::io_context& io, const Config& config,
                         const TopicScheme& scheme, Gateway& gateway,
                         MachineDriver<Gateway>& gateway_driver, Meshes& meshes, Upstream& upstream,
                         Submit submit)
    : scheme_(scheme),
      names_(scheme),
      gateway_(gateway),
      gateway_driver_(gateway_driver),
      meshes_(meshes),
      upstream_(upstream),
      submit_(std::move(submit)),
      started_(read_clocks().wall),
      last_alive_(io, config.store.directory),
      neighbours_(config.gateway_id),
      host_(
          io, names_,
          [this](const std::string& robot) { return neighbours_.is_served_elsewhere(robot); },
          last_alive_.before_start() ? std::optional(last_alive_.before_start()->time)
                                     : std::nullopt,
          [this](sessions::SessionHost::Report report) { perform(report); }),
      tick_(io),
      newcomer_timer_(io),
      broker_uri_(last_alive_.before_start() ? last_alive_.before_start()->uri : std::string()) {
  gateway_.set_places(places());
  meshes_.ask_where_served([this](const std::string& robot) { return is_shown(robot); });
  meshes_.share_ble(
      [this](const std::string& robot) {
        return !is_waking() && (is_held(robot) || (!up_since_ && held_before_.contains(robot)));
      },
      [this](const std::string& robot, const std::optional<RadioFacts>& radio) {
        on_heard_by_board(robot, radio);
      });
}

RobotPlaces FleetMember::places() {
  return {[this](const std::string& robot) { return !is_waking() && is_held(robot); },
          [this](const std::string& robot) { return neighbours_.is_served_elsewhere(robot); },
          [this](const std::string& robot) { return is_shown(robot); },
          [this](const std::string& robot) {
            return host_.sessions().is_refused(robot) && !neighbours_.is_served_elsewhere(robot);
          },
          [this] { return neighbours_.gateways().empty(); },
          [this](const std::string& robot, const std::string& topic) {
            // A robot on BLE takes all commands, but its filter may come just after its session.
            return meshes_.presence_of(Mesh::ble, robot) || host_.sessions().may_want(robot, topic);
          }};
}

void FleetMember::start() {
  gateway_driver_->subscribe_own(scheme_.state_filter());
  gateway_driver_->subscribe_own(scheme_.presence_filter());
  tick_.every(tick_interval, [this] { on_tick(); });
}

void FleetMember::stop() {
  tick_.cancel();
  newcomer_timer_.cancel();
  host_.stop();
  last_alive_.stop();
}

// --- Messages of the broker ----------------------------------------------------------------------

void FleetMember::on_broker_link(bool is_up) {
  if (!is_up) {
    const TimePoint now = read_clocks().mono;
    if (std::exchange(up_since_, std::nullopt)) last_up_ = host_.sessions().lost_since(now);
    has_kept_orphans_ = false;
    last_alive_.on_broker_down();
    return host_.on_broker_down();
  }
  up_since_ = read_clocks().mono;
  const std::string uri = upstream_.common_uri();
  const bool is_other = std::exchange(broker_uri_, uri) != uri;
  neighbours_.on_broker_up(is_other);
  if (is_other) {
    taken_.clear();
    sends_retained_ = false;
  }
  last_alive_.on_broker_up(uri);
  gateway_driver_->hear_all_commands(neighbours_.is_first());
  for (const auto& [robot, presence] : adopted_)
    submit_({scheme_.presence_topic(robot), to_bytes(presence), Qos::at_least_once, true});
  host_.on_broker_up({upstream_.broker(), upstream_.way(), upstream_.version()}, is_other);
}

void FleetMember::on_silence(bool is_silent) { host_->on_silence(is_silent); }

bool FleetMember::is_settled() const {
  return up_since_ && read_clocks().mono - *up_since_ >= settling;
}

bool FleetMember::takes(const BrokerMessage& message) {
  if (const auto gateway = scheme_.gateway_of_state(message.topic)) {
    if (*gateway == scheme_.gateway_id()) {
      // A broker that sends retained messages does so before our new state comes back.
      sends_retained_ = sends_retained_ || message.retain;
      if (!message.retain && sends_retained_ && neighbours_.gateways().empty())
        host_->attach_kept(read_clocks());
      return false;
    }
    on_state(std::string(*gateway), message);
    return true;
  }
  if (const auto shown = scheme_.parse_presence_topic(message.topic))
    return on_presence(std::string(shown->gateway), std::string(shown->robot), message);
  if (const auto gateway = scheme_.gateway_of_hears(message.topic)) {
    const auto hears = sessions::read_hears(message.payload);
    if (hears && *gateway != scheme_.gateway_id())
      board_choice_.on_hears(std::string(*gateway), *hears, read_clocks().mono);
    return true;
  }
  return false;
}

/// Some brokers send no retained messages to a subscription with wildcards, so a newcomer misses
/// the presence of robots. So each gateway publishes its own again, once for all newcomers. A
/// gateway that has connected again is one, too: it may not have been seen to go.
void FleetMember::on_state(const std::string& gateway, const BrokerMessage& message) {
  const auto known = neighbours_.gateways().find(gateway);
  const auto before =
      known == neighbours_.gateways().end() ? sessions::Neighbours::State{} : known->second;
  const TimePoint now = read_clocks().mono;
  // A gateway that is shown as dead after an outage was alive before it.
  const TimePoint last_alive = message.retain ? last_up_ : now;
  for (const auto& orphan : neighbours_.on_state(gateway, message.payload)) {
    if (is_held(orphan.robot))
      withdraw_from(gateway, orphan.robot);
    else
      keep(orphan.robot, last_alive, orphan.after);
  }
  gateway_driver_->hear_all_commands(neighbours_.is_first());
  give_up_lost();
  const auto after = neighbours_.gateways().find(gateway);
  if (after == neighbours_.gateways().end() || !after->second.is_online) return;
  if (!before.is_online) log_newcomer(gateway, now);
  const bool is_newcomer =
      !before.is_online || !before.is_shown || before.connected != after->second.connected;
  if (!is_newcomer || message.retain) return;
  newcomer_timer_.after(newcomer_delay, [this] {
    if (!up_since_) return;
    gateway_driver_->presence().publish_state();
    gateway_driver_->presence().announce_all(read_clocks());
  });
}

void FleetMember::log_newcomer(const std::string& gateway, TimePoint now) {
  const bool is_one_of_many = neighbours_.gateways().size() > max_newcomer_lines;
  const auto count =
      is_one_of_many ? newcomer_lines_.on_event(now) : std::optional<std::uint64_t>(1);
  if (!count) return;
  log_event(Severity::notice,
            fmt::format(
                "gateway '{}' also uses this broker{}", gateway,
                *count > 1 ? fmt::format(" ({} such gateways since the last line)", *count) : ""));
}

/// Returns false for a presence under this gateway's own name, which the core handles. If a former
/// process left it, this gateway keeps the robot's session.
bool FleetMember::on_presence(const std::string& gateway, const std::string& robot,
                              const BrokerMessage& message) {
  if (gateway == scheme_.gateway_id()) {
    const bool is_former = message.retain && !message.payload.empty() &&
                           !gateway_.registry().find(robot) && !adopted_.contains(robot);
    if (is_former) keep(robot, {}, former_delay);
    return false;
  }
  neighbours_.on_presence(gateway, robot, message.payload);
  if (neighbours_.is_heard_elsewhere(robot)) {
    held_before_.erase(robot);
    if (!message.retain) host_->on_shown_elsewhere(robot, read_clocks());
  }
  if (lost_.contains(robot) && has_moved(robot)) give_up(robot);
  return true;
}

/// Gives up lost robots that another gateway serves, because a gateway's presence may come before
/// its state.
void FleetMember::give_up_lost() {
  for (const std::string& robot : std::set<std::string>(lost_))
    if (has_moved(robot)) give_up(robot);
}

/// Returns false for a robot that is here while the other gateway shows it as offline: that gateway
/// only answers for it, as if this one had died.
bool FleetMember::has_moved(const std::string& robot) const {
  return is_here(robot) ? neighbours_.is_heard_elsewhere(robot)
                        : neighbours_.is_served_elsewhere(robot);
}

bool FleetMember::is_here(const std::string& robot) const {
  return std::ranges::any_of(all_meshes, [&](Mesh mesh) {
    return meshes_.presence_of(mesh, robot).value_or(Presence::offline) != Presence::offline;
  });
}

// --- Events of the meshes ------------------------------------------------------------------------

void FleetMember::on_mesh_event(const MeshEvent& event) {
  std::visit([this](const auto& what) { handle(what); }, event);
}

void FleetMember::handle(const SubscribeRequest& request) {
  host_->subscribe(request.robot, request.filter, request.qos, request.is_standing, read_clocks());
  if (request.is_standing) return keep(request.robot, {}, former_delay);
  lost_.erase(request.robot);
}

void FleetMember::handle(const UnsubscribeRequest& request) {
  host_->unsubscribe(request.robot, request.filter);
}

/// Also withdraws the note that the robot's former gateway may have left.
void FleetMember::handle(const SessionCleaned& cleaned) {
  if (neighbours_.robots().contains(cleaned.robot))
    submit_({names_.note_topic(cleaned.robot), {}, Qos::at_least_once, true});
  host_->begin_clean(cleaned.robot, read_clocks());
}

void FleetMember::handle(const NoteChanged& change) {
  if (neighbours_.is_served_elsewhere(change.robot) && !is_held(change.robot)) return;
  submit_({names_.note_topic(change.robot), change.note, Qos::at_least_once, true});
}

void FleetMember::handle(const NoteRequest& request) {
  lost_.erase(request.robot);
  host_->read_note(request.robot, read_clocks());
}

void FleetMember::handle(const Report& report) {
  if (report.is_will) return host_->prove(report.robot);
  on_heard(report.mesh, report.robot);
}

/// From now on the core shows the robot. While the broker is offline, also before its first
/// connection, the robot may be at another gateway already.
void FleetMember::handle(const PresenceChange& change) {
  if (!adopted_.empty()) adopted_.erase(change.robot);
  if (!up_since_ && !meshes_.is_shared(change.mesh)) lost_.insert(change.robot);
}

void FleetMember::handle(const LinkChange& change) {
  if (change.mesh == Mesh::ble) board_choice_.on_board(change.is_up);
}

/// Ignores robots of a shared mesh: on_heard_by_board() handles them.
void FleetMember::on_heard(Mesh mesh, const std::string& robot) {
  if (!meshes_.is_shared(mesh)) attach(robot);
}

void FleetMember::attach(const std::string& robot) {
  if (!lost_.empty()) lost_.erase(robot);
  host_->on_heard(robot, read_clocks());
}

void FleetMember::on_heard_by_board(const std::string& robot,
                                    const std::optional<RadioFacts>& radio) {
  std::optional<sessions::SignalLevel> level;
  if (radio && radio->rssi_dbm)
    level = sessions::SignalLevel{*radio->rssi_dbm -
                                  sessions::SignalLevel::relay_cost_db * radio->hops.value_or(0)};
  board_choice_.on_heard(robot, level, read_clocks().mono);
  if (is_held(robot) || should_attach(robot)) attach(robot);
}

/// True when this gateway's board should serve a robot whose session it does not hold. All boards
/// hear the robot, so one that another gateway has just taken need not be shown yet.
bool FleetMember::should_attach(const std::string& robot) {
  if (!is_settled()) return false;
  const TimePoint now = read_clocks().mono;
  if (!neighbours_.is_served_elsewhere(robot)) return !host_.sessions().was_just_taken(robot, now);
  return board_choice_.should_take(robot, neighbours_.robots().at(robot).gateway, now);
}

/// Keeps the robot's session at this gateway, unless another one hears the robot within `after`.
void FleetMember::keep(const std::string& robot, std::optional<TimePoint> unheld_since,
                       Duration after) {
  if (!is_held(robot)) host_->keep(robot, unheld_since, after, read_clocks());
}

/// Ends the robot's service here. Messages that have not been on the air go to its next gateway.
void FleetMember::give_up(const std::string& robot) {
  lost_.erase(robot);
  held_before_.erase(robot);
  adopted_.erase(robot);
  for (const WaitingMessage& waiting : meshes_.give_up(robot)) {
    if (waiting.command != CommandId::none)
      gateway_driver_->commands().on_handed_on(waiting.command);
    submit_({names_.mailbox_topic(robot), sessions::encode_waiting(waiting), Qos::at_least_once});
  }
  host_->on_given_up(robot);
  gateway_driver_->presence().on_given_up(robot);
}

/// A command came for a robot of this gateway whose session is not held here. Another gateway may
/// serve a lost robot without having shown it yet, so the robot is left to it for a while.
void FleetMember::perform(WantSession& action) {
  if (!lost_.contains(action.robot)) return attach(action.robot);
  keep(action.robot, {}, RobotSessions::unheard_delay);
}

void FleetMember::perform(RobotForgotten& action) {
  lost_.erase(action.robot);
  held_before_.erase(action.robot);
  adopted_.erase(action.robot);
  host_->forget(action.robot);
}

/// Withdraws presence in place of gateways that stand still, which do not withdraw it themselves.
void FleetMember::withdraw_from_still_gateways() {
  if (is_waking()) return taken_.clear();
  const TimePoint now = read_clocks().mono;
  std::erase_if(taken_, [&](const auto& taken) {
    const auto& [robot, since] = taken;
    if (is_held(robot) && now - since < withdrawal_patience) return false;
    const auto shown = neighbours_.robots().find(robot);
    if (is_held(robot) && shown != neighbours_.robots().end())
      withdraw_from(shown->second.gateway, robot);
    return true;
  });
}

void FleetMember::withdraw_from(const std::string& gateway, const std::string& robot) {
  submit_({scheme_.presence_topic_at(gateway, robot), {}, Qos::at_least_once, true});
}

/// Answers for robots of gateways that were gone before this one heard of them, once for each
/// connection. Commands that wait for these robots are old.
void FleetMember::keep_orphans() {
  if (!is_settled() || std::exchange(has_kept_orphans_, true)) return;
  const TimePoint long_ago = read_clocks().mono - 2 * sessions::RobotSession::stale_after;
  neighbours_.on_settled();
  for (const auto& orphan : neighbours_.orphans()) keep(orphan.robot, long_ago, orphan.after);
  gateway_driver_->hear_all_commands(neighbours_.is_first());
}

void FleetMember::on_tick() {
  withdraw_from_still_gateways();
  keep_orphans();
  if (!meshes_.is_shared(Mesh::ble) || !up_since_) return;
  gateway_driver_->subscribe_own(scheme_.hears_filter());
  const TimePoint now = read_clocks().mono;
  if (const auto hears = board_choice_.next_hears(now))
    submit_({scheme_.hears_topic(), to_bytes(sessions::to_json_text(*hears)), Qos::at_most_once});
  for (const std::string& robot : board_choice_.candidates(now))
    if (!is_held(robot) && should_attach(robot)) attach(robot);
}

// --- Events of the sessions ----------------------------------------------------------------------

void FleetMember::perform(sessions::SessionHost::Report& report) {
  std::visit(
      overloaded{
          [this](sessions::SessionHeld& held) { on_held(held); },
          [this](sessions::SessionLost& lost) { on_lost(lost); },
          [this](sessions::SessionProven& proven) {
            gateway_driver_->on_session_proven(proven.robot, read_clocks());
          },
          [this](sessions::SessionSorted& sorted) {
            gateway_driver_->commands().on_session_sorted(sorted.robot);
          },
          [this](sessions::FilterAnswered& it) {
            meshes_.each(&MeshAdapter::on_subscribe_result, it.robot, it.filter, it.is_granted);
          },
          [this](sessions::TakeMessage& it) {
            gateway_driver_->commands().on_robot_message(
                RobotMessage{it.robot, std::move(it.message), CommandId::none, it.is_unasked},
                read_clocks());
          },
          [this](sessions::RefuseStale& it) {
            gateway_driver_->commands().on_stale_command(it.robot, std::move(it.message),
                                                         it.has_begun_anew);
          },
          [this](sessions::NoteRead& it) {
            meshes_.each(&MeshAdapter::on_note, it.robot, std::optional<ByteView>(it.note));
          },
          [this](sessions::SessionContested& it) {
            gateway_driver_->presence().on_contested(it.robot, it.is_contested, read_clocks());
          },
          [](Notice& notice) { log_notice(notice); },
      },
      report);
}

void FleetMember::on_held(const sessions::SessionHeld& held) {
  lost_.erase(held.robot);
  held_before_.erase(held.robot);
  if (neighbours_.is_served_elsewhere(held.robot)) taken_[held.robot] = read_clocks().mono;
  meshes_.each(&MeshAdapter::on_session_held, held.robot);  // a mesh may show the robot from now on
  gateway_driver_->on_session_held(held.robot, held.was_present, adopt(held.robot), read_clocks());
}

/// Returns the gateway that showed the robot and is gone; may be empty. The core clears that
/// gateway's entry. If the robot is not here, this gateway shows it as offline from now on.
std::string FleetMember::adopt(const std::string& robot) {
  const auto shown = neighbours_.robots().find(robot);
  if (shown == neighbours_.robots().end() || neighbours_.is_served_elsewhere(robot)) return {};
  const std::string dead_owner = shown->second.gateway;
  if (!gateway_.registry().find(robot) && !is_here(robot)) {
    auto presence = Json::parse(shown->second.document, nullptr, false);
    presence["state"] = "offline";
    presence["since"] = to_iso8601(read_clocks().wall);
    submit_({scheme_.presence_topic(robot), to_bytes(presence.dump()), Qos::at_least_once, true});
    adopted_[robot] = presence.dump();
  }
  return dead_owner;
}

/// Does not give the robot up at once: the broker may just have closed one connection, and the
/// robot's next message takes the session back.
void FleetMember::on_lost(const sessions::SessionLost& lost) {
  if (lost.why != sessions::LossReason::taken) {
    if (!neighbours_.is_heard_elsewhere(lost.robot)) held_before_.insert(lost.robot);
    return;
  }
  held_before_.erase(lost.robot);
  lost_.insert(lost.robot);
  if (has_moved(lost.robot)) give_up(lost.robot);
}

// --- For operators -------------------------------------------------------------------------------

const char* FleetMember::state() const {
  if (!up_since_) return "cut off";
  for (const auto& [id, other] : neighbours_.gateways())
    if (other.is_online) return "member";
  return "alone";
}

Json FleetMember::gateways() const {
  std::map<std::string, std::size_t> counts;
  for (const auto& [robot, shown] : neighbours_.robots()) ++counts[shown.gateway];
  std::size_t& own = counts[scheme_.gateway_id()] = gateway_.registry().robots().size();
  for (const auto& [robot, presence] : adopted_)
    if (!gateway_.registry().find(robot)) ++own;
  Json rows = Json::array({{{"gateway", scheme_.gateway_id()},
                            {"state", state()},
                            {"robots", own},
                            {"version", SLAMGW_VERSION},
                            {"since", to_iso8601(started_)}}});
  for (const auto& [id, other] : neighbours_.gateways())
    rows.push_back({{"gateway", id},
                    {"state", other.is_online ? "member" : "gone"},
                    {"robots", counts[id]},
                    {"version", other.version},
                    {"since", other.since}});
  return rows;
}

/// `served`: false when the gateway that shows the robot is gone, or does not hold its session.
Json FleetMember::robots() const {
  Json rows = Json::array();
  const auto add = [&](const std::string& robot, const std::string& gateway, std::string since,
                       bool is_served) -> Json& {
    rows.push_back(
        {{"robot", robot}, {"gateway", gateway}, {"since", since}, {"served", is_served}});
    return rows.back();
  };
  for (const auto& [id, robot] : gateway_.registry().robots()) {
    if (!robot.presence().is_known) continue;
    Json& row = add(id, scheme_.gateway_id(), to_iso8601(robot.presence().since), is_held(id));
    if (robot.is_contested()) row["contested"] = true;
    if (host_.sessions().is_refused(id))
      row["refused"] = "the robot's session (client id " + names_.client_id(id) + ")";
    else if (const auto filter = host_.sessions().refused_filter(id))
      row["refused"] = "the subscription to " + *filter;
  }
  for (const auto& [robot, presence] : adopted_)
    if (!gateway_.registry().find(robot))
      add(robot, scheme_.gateway_id(), Json::parse(presence).value("since", ""), is_held(robot));
  for (const auto& [robot, shown] : neighbours_.robots())
    if (!is_held(robot))
      add(robot, shown.gateway, shown.since, neighbours_.is_served_elsewhere(robot));
  return rows;
}

Json FleetMember::status() const {
  return {{"gateway", scheme_.gateway_id()}, {"gateways", gateways()}, {"robots", robots()}};
}

}  // namespace slamgw
