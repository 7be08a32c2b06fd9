// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/paho_upstream.hpp"

#include <MQTTAsync.h>
#include <fmt/format.h>

#include <utility>

#include "daemon/mqtt/connect_failure.hpp"

namespace slamgw {
namespace {

constexpr std::chrono::milliseconds first_wait{500};
constexpr std::chrono::milliseconds longest_wait{30000};
/// A connection that lasts so long ends the back-off.
constexpr std::chrono::seconds stable_after{10};
constexpr unsigned suspicious_lives = 2;
/// From a change of the network to its use: addresses and routes come one after the other.
constexpr std::chrono::milliseconds network_settles{300};

/// OpenSSL sets itself up where TLS is used; Paho would have it load all it has in any case, 1.4
/// MiB.
void keep_openssl_small() {
  MQTTAsync_init_options options = MQTTAsync_init_options_initializer;
  options.do_openssl_init = 0;
  MQTTAsync_global_init(&options);
}

/// Whom the broker has refused, and where that is mended.
std::string explain_credentials(const BrokerSettings& settings) {
  if (!settings.credentials)
    return " (no user name was sent): give one in broker.credentials_file, for the packaged "
           "service "
           "in /etc/slam-gateway/credentials.json, and restart";
  const std::string& user = settings.credentials->username;
  if (settings.credentials_file)
    return fmt::format(
        " (user '{}' from {}): correct that file, or the broker's password for the user", user,
        *settings.credentials_file);
  return fmt::format(
      " (user '{}' from the systemd credential `broker`): correct /etc/slam-gateway/"
      "credentials.json and restart, or correct the broker's password for the user",
      user);
}

}  // namespace

PahoUpstream::PahoUpstream(boost::asio::io_context& io, BrokerSettings settings, LastWill will,
                           UpstreamListener& listener)
    : io_(io),
      settings_(std::move(settings)),
      will_(std::move(will)),
      listener_(listener),
      reconnect_timer_(io),
      nudge_timer_(io),
      backoff_(first_wait, longest_wait),
      random_(std::random_device{}()) {}

PahoUpstream::~PahoUpstream() { stop(); }

void PahoUpstream::start() {
  keep_openssl_small();
  connect();
}

void PahoUpstream::stop() {
  reconnect_timer_.cancel();
  nudge_timer_.cancel();
  drop_session(true);
  lane_.join();
}

void PahoUpstream::reconfigure(const BrokerSettings& settings) {
  if (settings == settings_) return;
  settings_ = settings;
  version_ = {};
  will_.qos = Qos::at_least_once;
  will_.is_retained = true;
  backoff_.reset();
  const bool was_up = is_up_;
  drop_session(true);
  if (was_up) listener_.on_link_down("the configuration has changed");
  connect_in(Duration::zero());
}

void PahoUpstream::retry_now() {
  if (!is_waiting_) return;
  backoff_.reset();
  connect_in(network_settles);
}

void PahoUpstream::connect() {
  is_waiting_ = false;
  if (read_credentials_) settings_.credentials = read_credentials_();
  session_ =
      std::make_shared<PahoSession>(io_, lane_, settings_, version(), will_, attempt_++, *this);
  session_->connect();
}

void PahoUpstream::connect_in(Duration wait) {
  is_waiting_ = true;
  reconnect_timer_.expires_after(wait);
  reconnect_timer_.async_wait([this](boost::system::error_code error) {
    if (!error) connect();
  });
}

void PahoUpstream::drop_session(bool is_orderly) {
  is_up_ = false;
  nudge_.clear();
  if (session_) std::exchange(session_, nullptr)->abandon(is_orderly);
}

void PahoUpstream::reconnect_later(const std::string& why) {
  drop_session(false);
  const double jitter = std::uniform_real_distribution<double>(0, 1)(random_);
  connect_in(backoff_.next_wait(jitter));
  listener_.on_link_down(why);
}

void PahoUpstream::on_connected(bool session_present, const BrokerLimits& limits) {
  is_up_ = true;
  attempt_ = 0;
  up_since_ = std::chrono::steady_clock::now();
  listener_.on_link_up(session_present, limits);
}

void PahoUpstream::on_connect_failed(ConnectFailure failure) {
  if (version_.on_failed(failure.answer) || adapt_will(failure.code)) {
    drop_session(false);
    connect();
    return;
  }
  if (failure.is_not_authorised) {
    failure.text += explain_credentials(settings_);
  }
  reconnect_later(failure.text);
}

/// True when the broker refuses the last will for a property that it can go without.
bool PahoUpstream::adapt_will(int code) {
  constexpr int retain_not_supported = 0x9a;
  constexpr int qos_not_supported = 0x9b;
  if (code == retain_not_supported) return std::exchange(will_.is_retained, false);
  if (code == qos_not_supported)
    return std::exchange(will_.qos, Qos::at_most_once) != Qos::at_most_once;
  return false;
}

/// Two gateways with one client id throw each other out without end; not every broker says so.
void PahoUpstream::on_lost(std::string why) {
  version_.on_lost();
  const bool has_lasted = std::chrono::steady_clock::now() - up_since_ >= stable_after;
  if (has_lasted) backoff_.reset();
  short_lives_ = has_lasted ? 0 : short_lives_ + 1;
  if (short_lives_ == suspicious_lives)
    why += fmt::format(" soon after it came up, again and again; perhaps {}",
                       explain_rival(settings_.client_id));
  reconnect_later(why);
}

void PahoUpstream::on_published(std::uint64_t sequence) {
  nudge_.on_acknowledged(std::chrono::steady_clock::now());
  listener_.on_published(sequence);
}

void PahoUpstream::on_publish_refused(std::uint64_t sequence, const Refusal& refusal) {
  nudge_.on_acknowledged(std::chrono::steady_clock::now());
  listener_.on_publish_refused(sequence, refusal);
}

void PahoUpstream::on_subscribe_result(const std::string& filter, bool granted) {
  listener_.on_subscribe_result(filter, granted);
}

void PahoUpstream::on_message(BrokerMessage message, std::vector<std::uint32_t> subscriptions) {
  listener_.on_message(std::move(message), std::move(subscriptions));
}

void PahoUpstream::publish(std::uint64_t sequence, BrokerMessage message) {
  if (!is_up_) return;
  session_->publish(sequence, std::move(message));
  nudge_.on_publish(std::chrono::steady_clock::now());
  if (!is_nudge_armed_) watch_progress();
}

/// One timer for all messages: at full rate it fires some 40 times a second, idle never.
void PahoUpstream::watch_progress() {
  const auto deadline = nudge_.deadline();
  is_nudge_armed_ = deadline.has_value();
  if (!deadline) return;
  nudge_timer_.expires_at(*deadline);
  nudge_timer_.async_wait([this](boost::system::error_code error) {
    if (error) return;
    if (is_up_ && nudge_.take(std::chrono::steady_clock::now())) session_->nudge();
    watch_progress();
  });
}

void PahoUpstream::subscribe(const std::string& filter, Qos qos, std::uint32_t id) {
  if (is_up_) session_->subscribe(filter, qos, id);
}

void PahoUpstream::unsubscribe(const std::string& filter) {
  if (is_up_) session_->unsubscribe(filter);
}

}  // namespace slamgw
