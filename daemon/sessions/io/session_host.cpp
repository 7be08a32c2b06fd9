// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/io/session_host.hpp"

#include <fmt/format.h>

#include <utility>

namespace slamgw::sessions {

SessionHost::SessionHost(boost::asio::io_context& io, SessionNames names,
                         RobotSessions::ServedElsewhere is_served_elsewhere,
                         std::optional<TimePoint> last_alive, std::function<void(Report)> report)
    : names_(names),
      report_(std::move(report)),
      sessions_(std::move(names), std::move(is_served_elsewhere), last_alive),
      driver_(io, sessions_,
              [this](SessionAction& action) {
                std::visit([this](auto& what) { perform(what); }, action);
              }),
      links_(io, *this) {}

void SessionHost::on_broker_up(const BrokerSettings& broker, MqttVersion version) {
  const std::string uri = broker.addresses().front().uri();
  is_other_ = is_other_ || (!uri_.empty() && (uri != uri_ || version != version_));
  uri_ = uri;
  version_ = version;
  is_broker_up_ = true;
  links_.use(broker, version);
}

void SessionHost::on_broker_down() {
  is_broker_up_ = false;
  refused_.clear();
  driver_->on_broker_down(read_clocks());
}

void SessionHost::on_ready() {
  if (!is_broker_up_) return;
  driver_->on_broker_up(version_ == MqttVersion::v5, std::exchange(is_other_, false),
                        read_clocks());
}

void SessionHost::stop() {
  driver_->on_stop();
  driver_.stop();
  links_.stop();
}

void SessionHost::on_attached(const std::string& robot, bool is_present) {
  refused_.erase(robot);
  driver_->on_attached(robot, is_present, read_clocks());
}

void SessionHost::on_attach_failed(const std::string& robot, const AttachFailure& failure) {
  if (const auto count = failure_throttle_.on_event(read_clocks().mono))
    report_(Notice{Severity::warning,
                   fmt::format("{} ({} like it)", explain(robot, failure), *count), robot});
  refused_.insert(robot);
  driver_->on_attach_failed(robot, read_clocks());
}

std::string SessionHost::explain(const std::string& robot, const AttachFailure& failure) const {
  if (failure.is_without_files)
    return fmt::format(
        "{}: its session at the broker cannot be opened: too many open files; raise RLIMIT_NOFILE "
        "(LimitNOFILE= of the service; each robot needs 4)",
        robot);
  return fmt::format(
      "{}: the broker does not give its session to this gateway: {}{}", robot, failure.why,
      failure.is_id_refused
          ? fmt::format("; it does not let this gateway use client ids {}", names_.client_id("*"))
          : "");
}

void SessionHost::on_detached(const std::string& robot) {
  driver_->on_detached(robot, read_clocks());
}

void SessionHost::on_subscribed(const std::string& robot, const std::string& filter,
                                bool is_granted) {
  if (!is_granted && filter == names_.mailbox_topic(robot)) {
    if (const auto count = mailbox_throttle_.on_event(read_clocks().mono))
      report_(Notice{Severity::warning,
                     fmt::format("{}: the broker does not let this gateway read {}, by which "
                                 "robots' commands follow them between gateways; its access list "
                                 "needs `topic readwrite <prefix>/fleet/robots/#` ({} like it)",
                                 robot, filter, *count),
                     robot});
  }
  driver_->on_subscribed(robot, filter, is_granted, read_clocks());
}

void SessionHost::on_message(const std::string& robot, BrokerMessage message,
                             std::vector<std::uint32_t> ids) {
  driver_->on_message(robot, std::move(message), ids, read_clocks());
}

void SessionHost::on_fence(const std::string& robot, std::uint64_t number) {
  driver_->on_fence(robot, number, read_clocks());
}

void SessionHost::perform(OpenSession& open) {
  links_.open(open.robot, names_.client_id(open.robot), open.is_clean);
}

void SessionHost::perform(CloseSession& close) { links_.close(close.robot, close.is_forgotten); }

void SessionHost::perform(SubscribeSession& subscribe) {
  links_.subscribe(subscribe.robot, subscribe.filter, subscribe.qos, subscribe.id,
                   subscribe.wants_retained);
}

void SessionHost::perform(UnsubscribeSession& unsubscribe) {
  links_.unsubscribe(unsubscribe.robot, unsubscribe.filter);
}

void SessionHost::perform(AskFence& fence) {
  links_.ask_fence(fence.robot, fence.number, names_.mailbox_topic(fence.robot));
}

void SessionHost::perform(SendMarker& marker) {
  links_.publish(marker.robot, names_.mailbox_topic(marker.robot), marker.text);
}

}  // namespace slamgw::sessions
