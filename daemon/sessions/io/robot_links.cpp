// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/io/robot_links.hpp"

#include <boost/asio/post.hpp>
#include <chrono>
#include <mutex>
#include <thread>

#include "daemon/sessions/io/robot_link.hpp"

namespace slamgw::sessions {
namespace {

/// libmosquitto's unit of time.
constexpr std::chrono::seconds tick{1};

TimePoint now() { return std::chrono::steady_clock::now(); }

}  // namespace

struct RobotLinks::Asker {
  std::mutex mutex;
  RobotLinks* links = nullptr;  ///< until stop()
};

RobotLinks::RobotLinks(boost::asio::io_context& io, RobotLinksListener& listener)
    : io_(io), listener_(listener), tick_(io), asker_(std::make_shared<Asker>()) {
  asker_->links = this;
  [[maybe_unused]] static const int once = mosquitto_lib_init();
  await_tick();
}

RobotLinks::~RobotLinks() { stop(); }

void RobotLinks::use(const BrokerSettings& broker, MqttVersion version) {
  if (broker_ && broker_->settings == broker && broker_->version == version) {
    return boost::asio::post(io_, [this] {
      if (!is_stopped_) listener_.on_ready();
    });
  }
  auto shared = std::make_shared<Broker>();
  shared->settings = broker;
  shared->version = version;
  std::thread([asker = asker_, shared, number = ++resolving_] {
    shared->addresses = resolve_host(shared->settings);
    if (shared->settings.tls) shared->tls = std::make_unique<TlsClient>(shared->settings);
    const std::lock_guard lock(asker->mutex);
    if (!asker->links) return;
    boost::asio::post(asker->links->io_, [links = asker->links, shared, number] {
      if (number == links->resolving_ && !links->is_stopped_) links->on_resolved(shared);
    });
  }).detach();
}

void RobotLinks::on_resolved(std::shared_ptr<Broker> broker) {
  while (!links_.empty()) close(std::string(links_.begin()->first), false);
  broker_ = std::move(broker);
  listener_.on_ready();
}

RobotLink* RobotLinks::find(const std::string& robot) {
  const auto found = links_.find(robot);
  return found == links_.end() ? nullptr : found->second.get();
}

void RobotLinks::open(const std::string& robot, const std::string& client_id, bool is_clean) {
  const auto link = std::make_shared<RobotLink>(*this, broker_, robot);
  links_[robot] = link;
  const std::string address =
      broker_ && !broker_->addresses.literals.empty()
          ? broker_->addresses.literals[attempts_++ % broker_->addresses.literals.size()]
          : std::string();
  link->open(client_id, is_clean, address, now() + connect_timeout);
}

void RobotLinks::close(const std::string& robot, bool is_forgotten) {
  if (RobotLink* link = find(robot)) {
    link->end(is_forgotten ? RobotLink::Farewell::forget : RobotLink::Farewell::disconnect);
    links_.erase(robot);
  }
}

void RobotLinks::remove(const std::string& robot) {
  if (RobotLink* link = find(robot)) {
    link->end(RobotLink::Farewell::none);
    links_.erase(robot);
  }
}

void RobotLinks::subscribe(const std::string& robot, const std::string& filter, Qos qos,
                           std::uint32_t id, bool wants_retained) {
  if (RobotLink* link = find(robot)) link->subscribe(filter, qos, id, wants_retained);
}

void RobotLinks::unsubscribe(const std::string& robot, const std::string& filter) {
  if (RobotLink* link = find(robot)) link->unsubscribe(filter);
}

void RobotLinks::ask_fence(const std::string& robot, std::uint64_t number,
                           const std::string& own_topic) {
  if (RobotLink* link = find(robot)) link->ask_fence(number, own_topic);
}

void RobotLinks::publish(const std::string& robot, const std::string& topic,
                         const std::string& text) {
  if (RobotLink* link = find(robot)) link->publish(topic, text);
}

void RobotLinks::await_tick() {
  tick_.expires_after(tick);
  tick_.async_wait([this](boost::system::error_code error) {
    if (error || is_stopped_) return;
    std::vector<std::shared_ptr<RobotLink>> links;
    for (const auto& [robot, link] : links_) links.push_back(link);
    for (const auto& link : links) link->on_tick(now());
    await_tick();
  });
}

void RobotLinks::stop() {
  if (std::exchange(is_stopped_, true)) return;
  tick_.cancel();
  while (!links_.empty()) close(std::string(links_.begin()->first), false);
  const std::lock_guard lock(asker_->mutex);
  asker_->links = nullptr;
}

}  // namespace slamgw::sessions
