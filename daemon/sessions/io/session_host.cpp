// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/io/session_host.hpp"

#include <fmt/format.h>

#include <boost/asio/post.hpp>
#include <mutex>
#include <thread>
#include <utility>

namespace slamgw::sessions {

struct SessionHost::Asker {
  std::mutex mutex;
  SessionHost* host = nullptr;  ///< until stop()
};

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
      tick_(io),
      resolve_timer_(io),
      asker_(std::make_shared<Asker>()) {
  asker_->host = this;
  await_tick();
}

// --- The broker ----------------------------------------------------------------------------------

/// Leads to on_resolved(), never from inside this call. Looks the name up each time, because the
/// broker's addresses and the files of TLS may have changed.
void SessionHost::on_broker_up(const BrokerSettings& broker, MqttVersion version) {
  const std::string uri = broker.addresses().front().uri();
  is_other_ = is_other_ || (!uri_.empty() && (uri != uri_ || version != version_));
  uri_ = uri;
  version_ = version;
  resolve(broker, version);
}

void SessionHost::resolve(const BrokerSettings& broker, MqttVersion version) {
  auto shared = std::make_shared<RobotBroker>();
  shared->settings = broker;
  shared->version = version;
  std::thread([asker = asker_, shared, number = ++resolving_] {
    shared->addresses = resolve_host(shared->settings);
    if (shared->settings.tls) shared->tls = std::make_unique<TlsClient>(shared->settings);
    const std::lock_guard lock(asker->mutex);
    if (!asker->host) return;
    boost::asio::post(asker->host->io_, [host = asker->host, shared, number] {
      if (number == host->resolving_ && !host->is_stopped_) host->on_resolved(shared);
    });
  }).detach();
}

void SessionHost::on_resolved(std::shared_ptr<RobotBroker> broker) {
  const bool is_same = broker_ && broker_->settings == broker->settings;
  if (is_same && broker->addresses.literals.empty()) broker->addresses = broker_->addresses;
  if (broker->addresses.literals.empty()) return resolve_later(*broker);
  broker_ = std::move(broker);
  driver_->on_broker_up(version_ == MqttVersion::v5, std::exchange(is_other_, false),
                        read_clocks());
}

/// The gateway's own connection has found the broker, so the name server failed for a moment.
void SessionHost::resolve_later(const RobotBroker& broker) {
  if (failure_throttle_.on_event(read_clocks().mono))
    report_(Notice{Severity::warning,
                   "robots' sessions wait for the broker's address: " + broker.addresses.problem,
                   {}});
  resolve_timer_.expires_after(resolve_pause);
  resolve_timer_.async_wait([this, settings = broker.settings, version = broker.version,
                             number = resolving_](boost::system::error_code error) {
    if (!error && number == resolving_ && !is_stopped_) resolve(settings, version);
  });
}

void SessionHost::on_broker_down() {
  ++resolving_;  // the answer of a look-up that is under way is dropped
  refused_.clear();
  driver_->on_broker_down(read_clocks());
}

void SessionHost::stop() {
  driver_->on_stop();
  driver_.stop();
  close_all();
}

void SessionHost::close_all() {
  if (std::exchange(is_stopped_, true)) return;
  tick_.cancel();
  resolve_timer_.cancel();
  end_links();
  const std::lock_guard lock(asker_->mutex);
  asker_->host = nullptr;
}

// --- From the links ------------------------------------------------------------------------------

void SessionHost::on_attached(const std::string& robot, bool is_present) {
  refused_.erase(robot);
  driver_->on_attached(robot, is_present, read_clocks());
}

void SessionHost::on_attach_failed(const std::string& robot, const AttachFailure& failure) {
  end_link(robot, RobotLink::Farewell::none);
  if (const auto count = failure_throttle_.on_event(read_clocks().mono))
    report_(Notice{
        Severity::warning,
        fmt::format("{} (count since the last line: {})", explain(robot, failure), *count), robot});
  if (failure.is_id_refused) refused_.insert(robot);
  driver_->on_attach_failed(robot, read_clocks());
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

void SessionHost::on_detached(const std::string& robot) {
  end_link(robot, RobotLink::Farewell::none);
  driver_->on_detached(robot, read_clocks());
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

void SessionHost::await_tick() {
  tick_.expires_after(MosquittoClient::tick_interval);
  tick_.async_wait([this](boost::system::error_code error) {
    if (error || is_stopped_) return;
    driver_->on_tick(read_clocks().mono);
    std::vector<std::shared_ptr<RobotLink>> links;
    for (const auto& [robot, link] : links_) links.push_back(link);
    for (const auto& link : links) link->on_tick();
    await_tick();
  });
}

void SessionHost::perform(OpenSession& open) {
  const auto link = std::make_shared<RobotLink>(io_, *this, broker_, open.robot);
  links_[open.robot] = link;
  const std::vector<std::string>& addresses = broker_->addresses.literals;
  link->open(names_.client_id(open.robot), open.is_clean,
             addresses.empty() ? std::string() : addresses[attempts_++ % addresses.size()]);
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
