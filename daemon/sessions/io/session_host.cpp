// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/io/session_host.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>
#include <vector>

namespace slamgw::sessions {

SessionHost::SessionHost(boost::asio::io_context& io, SessionNames names,
                         RobotSessions::ServedElsewhere is_served_elsewhere,
                         std::optional<TimePoint> last_alive, std::function<void(Report)> report)
    : io_(io),
      names_(names),
      report_(std::move(report)),
      sessions_(std::move(names), std::move(is_served_elsewhere), last_alive),
      driver_(io, sessions_,
              [this](SessionAction& action) {
                std::visit([this](auto& what) { perform(what); }, action);
              }),
      tick_(io) {
  tick_.every(MosquittoClient::tick_interval, [this] { on_tick(); });
}

// --- The broker ----------------------------------------------------------------------------------

void SessionHost::on_broker_up(RobotBroker broker, bool is_other) {
  has_subscription_ids_ = has_subscription_ids_ || is_other;
  if (!has_subscription_ids_) broker.version = MqttVersion::v3_1_1;
  broker_ = std::make_shared<const RobotBroker>(std::move(broker));
  driver_->on_broker_up(broker_->version == MqttVersion::v5, is_other, read_clocks());
}

void SessionHost::on_broker_down() { driver_->on_broker_down(read_clocks()); }

void SessionHost::stop() {
  driver_->on_stop();
  driver_.stop();
  close_all();
}

void SessionHost::close_all() {
  if (std::exchange(is_stopped_, true)) return;
  tick_.cancel();
  end_links();
}

// --- From the links ------------------------------------------------------------------------------

void SessionHost::on_attach_failed(const std::string& robot, const AttachFailure& failure) {
  end_link(robot, RobotLink::Farewell::none);
  if (const auto count = failure_throttle_.on_event(read_clocks().mono))
    report_(Notice{
        Severity::warning,
        fmt::format("{} (count since the last line: {})", explain(robot, failure), *count), robot});
  driver_->on_attach_failed(robot, read_clocks(), failure.is_id_refused);
}

std::string SessionHost::explain(const std::string& robot, const AttachFailure& failure) const {
  if (failure.is_id_refused)
    return fmt::format(
        "{}: the broker refuses this gateway the robot's session: {}; it does not let this gateway "
        "use client ids {}",
        robot, failure.why, names_.client_id("*"));
  if (failure.is_without_files)
    return fmt::format(
        "{}: its session at the broker cannot be opened: too many open files; raise RLIMIT_NOFILE "
        "(LimitNOFILE= of the service; each robot needs 4)",
        robot);
  return fmt::format("{}: its session at the broker cannot be opened: {}", robot, failure.why);
}

void SessionHost::on_detached(const std::string& robot, LossReason why) {
  end_link(robot, RobotLink::Farewell::none);
  driver_->on_detached(robot, read_clocks(), why);
}

void SessionHost::on_subscribed(const std::string& robot, const std::string& filter,
                                bool is_granted) {
  if (!is_granted && filter == names_.mailbox_topic(robot)) {
    if (const auto count = mailbox_throttle_.on_event(read_clocks().mono))
      report_(Notice{
          Severity::warning,
          fmt::format("{}: the broker denies this gateway access to {}, which carries robots' "
                      "commands between gateways; its access list needs `topic readwrite "
                      "<prefix>/fleet/robots/#` (count since the last line: {})",
                      robot, filter, *count),
          robot});
  }
  driver_->on_subscribed(robot, filter, is_granted, read_clocks());
}

/// Begins again with MQTT 3.1.1, which has no identifiers: there the gateway does without them.
void SessionHost::on_no_subscription_ids() {
  if (!std::exchange(has_subscription_ids_, false)) return;
  report_(Notice{Severity::notice,
                 "the broker gives no subscription identifiers, or several with one message; "
                 "robots' sessions use MQTT 3.1.1",
                 {}});
  on_broker_down();
  on_broker_up(*broker_, /*is_other=*/false);
}

// --- To the links --------------------------------------------------------------------------------

RobotLink* SessionHost::find(const std::string& robot) {
  const auto found = links_.find(robot);
  return found == links_.end() ? nullptr : found->second.get();
}

void SessionHost::end_link(const std::string& robot, RobotLink::Farewell farewell) {
  const auto link = links_.extract(robot);
  if (link) link.mapped()->end(farewell);
}

void SessionHost::end_links() {
  while (!links_.empty()) end_link(links_.begin()->first, RobotLink::Farewell::disconnect);
}

/// Ticks each link every second time only, because a thousand links cost an idle daemon more than
/// all else. A broker, which may have set a shorter keep-alive, waits for half of it longer (MQTT 5
/// section 3.1.2.10).
void SessionHost::on_tick() {
  driver_->on_tick(read_clocks().mono);
  if (links_.empty()) return;
  const std::size_t rounds = broker_->settings.keep_alive >= std::chrono::seconds{8} ? 2 : 1;
  std::vector<std::shared_ptr<RobotLink>> links((links_.size() + rounds - 1) / rounds);
  auto next = links_.upper_bound(last_ticked_);
  for (auto& link : links) {
    if (next == links_.end()) next = links_.begin();
    last_ticked_ = next->first;
    link = (next++)->second;
  }
  for (const auto& link : links) link->on_tick();
}

void SessionHost::perform(OpenSession& open) {
  const auto link = std::make_shared<RobotLink>(io_, *this, broker_, open.robot);
  links_[open.robot] = link;
  const std::vector<std::string>& addresses = broker_->way.addresses;
  link->open(names_.client_id(open.robot), open.is_clean,
             addresses[attempts_++ % addresses.size()]);
}

void SessionHost::perform(CloseSession& close) {
  end_link(close.robot,
           close.is_forgotten ? RobotLink::Farewell::forget : RobotLink::Farewell::disconnect);
}

void SessionHost::perform(SubscribeSession& subscribe) {
  if (RobotLink* link = find(subscribe.robot)) link->subscribe(subscribe);
}

void SessionHost::perform(UnsubscribeSession& unsubscribe) {
  if (RobotLink* link = find(unsubscribe.robot)) link->unsubscribe(unsubscribe.filter);
}

void SessionHost::perform(AskFence& fence) {
  if (RobotLink* link = find(fence.robot))
    link->ask_fence(fence.number, names_.mailbox_topic(fence.robot));
}

void SessionHost::perform(SendMarker& marker) {
  if (RobotLink* link = find(marker.robot))
    link->publish(names_.mailbox_topic(marker.robot), marker.text);
}

}  // namespace slamgw::sessions
