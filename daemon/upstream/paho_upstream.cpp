// SPDX-License-Identifier: Apache-2.0
#include "daemon/upstream/paho_upstream.hpp"

#include <fmt/format.h>

#include <utility>

namespace slamgw {
namespace {

constexpr std::chrono::milliseconds first_wait{500};
constexpr std::chrono::milliseconds longest_wait{30000};

}  // namespace

PahoUpstream::PahoUpstream(boost::asio::io_context& io, BrokerSettings settings, LastWill will,
                           UpstreamListener& listener)
    : io_(io),
      settings_(std::move(settings)),
      will_(std::move(will)),
      listener_(listener),
      reconnect_timer_(io),
      backoff_(first_wait, longest_wait),
      random_(std::random_device{}()) {}

PahoUpstream::~PahoUpstream() { stop(); }

void PahoUpstream::start() { connect(); }

void PahoUpstream::stop() {
  reconnect_timer_.cancel();
  drop_session(true);
  lane_.join();
}

void PahoUpstream::connect() {
  session_ = std::make_shared<PahoSession>(io_, lane_, settings_, version_, will_, *this);
  session_->connect();
}

void PahoUpstream::drop_session(bool is_orderly) {
  is_up_ = false;
  if (session_) std::exchange(session_, nullptr)->abandon(is_orderly);
}

void PahoUpstream::reconnect_later(const std::string& why) {
  drop_session(false);
  const double jitter = std::uniform_real_distribution<double>(0, 1)(random_);
  reconnect_timer_.expires_after(backoff_.next_wait(jitter));
  reconnect_timer_.async_wait([this](boost::system::error_code error) {
    if (!error) connect();
  });
  listener_.on_link_down(why);
}

void PahoUpstream::on_connected(bool session_present, std::uint16_t receive_maximum) {
  is_up_ = true;
  backoff_.reset();
  listener_.on_link_up(session_present, receive_maximum);
}

void PahoUpstream::on_connect_failed(ConnectFailure failure) {
  if (failure.is_version_refused && version_ == MqttVersion::v5) {
    version_ = MqttVersion::v3_1_1;
    drop_session(false);
    connect();
    return;
  }
  if (failure.is_not_authorised) {
    const std::string credentials =
        settings_.credentials
            ? fmt::format("user '{}' from {}", settings_.credentials->username,
                          settings_.credentials_file.value_or("the systemd credential `broker`"))
            : "no user name: set broker.credentials_file";
    failure.text += " (" + credentials + ")";
  }
  reconnect_later(failure.text);
}

void PahoUpstream::on_lost(std::string cause) { reconnect_later(cause); }

void PahoUpstream::on_published(std::uint64_t sequence) { listener_.on_published(sequence); }

void PahoUpstream::on_publish_refused(std::uint64_t sequence, std::string why) {
  listener_.on_publish_refused(sequence, why);
}

void PahoUpstream::on_subscribe_result(const std::string& filter, bool granted) {
  listener_.on_subscribe_result(filter, granted);
}

void PahoUpstream::on_message(BrokerMessage message, std::vector<std::uint32_t> subscriptions) {
  listener_.on_message(std::move(message), std::move(subscriptions));
}

void PahoUpstream::publish(std::uint64_t sequence, BrokerMessage message) {
  if (is_up_) session_->publish(sequence, std::move(message));
}

void PahoUpstream::subscribe(const std::string& filter, Qos qos, std::uint32_t id) {
  if (is_up_) session_->subscribe(filter, qos, id);
}

void PahoUpstream::unsubscribe(const std::string& filter) {
  if (is_up_) session_->unsubscribe(filter);
}

}  // namespace slamgw
