// SPDX-License-Identifier: Apache-2.0
#include "web/server/io/broker_link.hpp"

#include <fmt/format.h>

#include <random>
#include <utility>

#include "daemon/config/io/load.hpp"
#include "daemon/mqtt/mosquitto/mosquitto_link.hpp"

namespace slamgw::web {
namespace {

/// Makes a random client id: the broker would disconnect two programs with one id again and again.
BrokerSettings with_own_id(BrokerSettings settings) {
  std::random_device random;
  settings.client_id = fmt::format("slam-gateway-web-{:08x}", random());
  return settings;
}

std::int64_t unix_ms() {
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  return std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
}

ConnectionTraits traits() {
  return {.make_link = &make_mosquitto_link,
          .max_inbound_octets = BrokerLink::max_packet,
          .credentials_file = "/etc/slam-gateway/web-credentials.json",
          .without_credentials =
              "(no user name was sent): give one in web-credentials.json, beside gateway.json, and "
              "restart slam-gateway-web"};
}

}  // namespace

BrokerLink::BrokerLink(boost::asio::io_context& io, BrokerSettings settings,
                       std::vector<std::string> filters, Listener listener)
    : filters_(std::move(filters)),
      listener_(std::move(listener)),
      gather_(io),
      upstream_(io, with_own_id(settings), traits(), *this) {
  upstream_.read_credentials_with([settings] { return load_credentials(settings); });
  upstream_.start();
}

std::optional<std::uint64_t> BrokerLink::publish(const CommandRequest& command) {
  if (!is_up_) return std::nullopt;
  upstream_.publish(++commands_, {.topic = command.topic,
                                  .payload = to_bytes(command.payload),
                                  .qos = Qos::at_least_once,
                                  .sender = std::make_shared<const Asker>(Asker{command.sender})});
  return commands_;
}

void BrokerLink::on_link_up(const BrokerLimits&) {
  is_up_ = true;
  last_failure_.clear();
  for (const std::string& filter : filters_) upstream_.subscribe(filter);
  listener_.on_state(true, {});
}

void BrokerLink::on_link_down(const std::string& why) {
  is_up_ = false;
  if (std::exchange(last_failure_, why) != why) listener_.on_state(false, why);
}

void BrokerLink::on_publish_refused(std::uint64_t sequence, const Refusal& refusal) {
  listener_.on_refused(sequence, refusal.why);
}

void BrokerLink::on_subscribe_result(const std::string& filter, bool is_granted) {
  if (!is_granted) listener_.on_unreadable(filter, "refused");
}

/// Passes on the first message of a series at once, later ones together.
void BrokerLink::on_message(slamgw::BrokerMessage message, const UserProperties& said) {
  BrokerMessage& arrived =
      gathered_.emplace_back(BrokerMessage{std::move(message.topic),
                                           {message.payload.begin(), message.payload.end()},
                                           unix_ms(),
                                           message.retain,
                                           {},
                                           {},
                                           {}});
  for (const auto& [name, value] : said) {
    if (name == mesh_property) arrived.mesh = value;
    if (name == gateway_property) arrived.gateway = value;
    if (name == received_at_property) arrived.received_at = value;
  }
  if (!is_gathering_) pass_on();
}

void BrokerLink::pass_on() {
  is_gathering_ = !gathered_.empty();
  if (!is_gathering_) return;
  for (const BrokerMessage& message : std::exchange(gathered_, {})) listener_.on_message(message);
  gather_.after(gathering, [this] { pass_on(); });
}

}  // namespace slamgw::web
