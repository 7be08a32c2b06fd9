// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/conversations/operator_pings.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

namespace slamgw::mqttsn {
namespace {

/// Returns why a client in this state can't be asked; empty if it can.
std::string_view obstacle(ClientState state) {
  switch (state) {
    case ClientState::active: break;
    case ClientState::asleep:
    case ClientState::awake: return "it is asleep and listens only after its own PINGREQ";
    case ClientState::disconnected: return "it has disconnected";
    case ClientState::lost: return "it is lost: it was silent for longer than its keep-alive time";
  }
  return {};
}

}  // namespace

void OperatorPings::ask(std::uint64_t id, const std::string& robot, TimePoint now) {
  const Open ping{id, robot, now};
  const ClientSession* session = clients_.find_robot(robot);
  if (!session) return end(ping, {}, "it has no MQTT-SN session here", now);
  if (const auto why = obstacle(session->state()); !why.empty())
    return end(ping, {}, std::string(why), now);
  if (open_.size() >= max_open) return end(ping, {}, "too many pings are under way", now);
  output_.send(*session, Pingreq{});
  open_.push_back(ping);
}

/// A PINGRESP answers all open pings of its client, because it names none of them.
void OperatorPings::on_pingresp(const ClientSession& session, TimePoint now) {
  const auto is_answered = [&](const Open& ping) { return ping.robot == session.robot; };
  for (const Open& ping : open_)
    if (is_answered(ping)) end(ping, now - ping.since, {}, now);
  std::erase_if(open_, is_answered);
}

std::optional<TimePoint> OperatorPings::deadline() const {
  return open_.empty() ? std::nullopt : std::optional(open_.front().since + patience);
}

void OperatorPings::on_deadline(TimePoint now) {
  while (deadline() && *deadline() <= now) {
    const Open ping = std::move(open_.front());
    open_.erase(open_.begin());
    end(ping, {},
        fmt::format("no PINGRESP in {} s, which many clients never send", patience.count()), now);
  }
}

void OperatorPings::end(const Open& ping, std::optional<Duration> after, const std::string& why,
                        TimePoint now) {
  using Milliseconds = std::chrono::duration<double, std::milli>;
  nlohmann::json answer{
      {"robot", ping.robot}, {"mesh", to_string(Mesh::thread)}, {"answered", after.has_value()}};
  if (after) answer["after_ms"] = Milliseconds(*after).count();
  if (!why.empty()) answer["why"] = why;
  if (const ClientSession* session = clients_.find_robot(ping.robot))
    answer["last_heard_s"] = std::chrono::duration<double>(now - session->last_heard).count();
  output_.end(PingEnded{
      ping.id, {answer.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace), {}}});
}

}  // namespace slamgw::mqttsn
