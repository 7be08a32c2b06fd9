// SPDX-License-Identifier: Apache-2.0
#include "daemon/mqtt/upstream.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/post.hpp>
#include <utility>

#include "daemon/mqtt/connect_failure.hpp"
#include "daemon/mqtt/connection_probe.hpp"
#include "daemon/mqtt/mosquitto/mosquitto_link.hpp"
#include "daemon/mqtt/user_properties.hpp"

namespace slamgw {
namespace {

constexpr std::chrono::milliseconds first_wait{500};
constexpr std::chrono::milliseconds longest_wait{30000};
/// Waits are short in an outage's first minutes: a broker that restarts, or its network, is back
/// soon.
constexpr Backoff::Eager eager{std::chrono::seconds{3}, std::chrono::minutes{5}};
/// Pause between two probes of the first broker (`broker.return_to_first`). It grows while that
/// broker takes connections and still cannot be used.
constexpr std::chrono::seconds first_probe_pause{5};
constexpr std::chrono::seconds longest_probe_pause{600};
constexpr std::chrono::seconds refusal_to_loss{1};
/// Wait after a change of the network: addresses and routes come one after the other.
constexpr std::chrono::milliseconds network_settles{300};

/// A filter to which the gateway never subscribes. The broker answers an UNSUBSCRIBE of it all the
/// same (MQTT 5 section 3.10.4). A SUBSCRIBE would need a right, and some brokers close the
/// connection when it is missing.
constexpr const char* question = "slam-gateway/alive";

/// Replaces `%n` in a client id by the broker's number. Some clusters (RabbitMQ) keep a client's
/// queue on the node where it was made; while that node is away, the id is of no use at another.
std::string client_id_at(std::size_t place, std::string id) {
  if (const auto mark = id.find("%n"); mark != std::string::npos)
    id.replace(mark, 2, std::to_string(place + 1));
  return id;
}

/// Names the rejected user and where to fix it.
std::string explain_credentials(const BrokerSettings& settings, const ConnectionTraits& traits) {
  if (!settings.credentials) return " " + traits.without_credentials;
  const std::string& user = settings.credentials->username;
  if (settings.credentials_file)
    return fmt::format(
        " (user '{}' from {}): correct that file, or the broker's password for the user", user,
        *settings.credentials_file);
  if (traits.credentials_file.empty()) return fmt::format(" ('{}')", user);
  return fmt::format(
      " (user '{}' from the systemd credential `broker`): correct {} and restart, or correct the "
      "broker's password for the user",
      user, traits.credentials_file);
}

}  // namespace

Upstream::Upstream(boost::asio::io_context& io, BrokerSettings settings, ConnectionTraits traits,
                   UpstreamListener& listener)
    : io_(io),
      settings_(std::move(settings)),
      traits_(std::move(traits)),
      listener_(listener),
      reconnect_timer_(io),
      stall_timer_(io),
      return_timer_(io),
      return_backoff_(first_probe_pause, longest_probe_pause),
      backoff_(first_wait, longest_wait, eager),
      random_(std::random_device{}()) {
  make_places();
}

Upstream::~Upstream() { stop(); }

void Upstream::start() { connect(); }

void Upstream::make_places() {
  places_.clear();
  for (BrokerAddress& address : settings_.addresses())
    places_.push_back(Place{std::move(address), {}, traits_.will});
  at_ = 0;
  tried_ = 0;
}

BrokerSettings Upstream::broker() const {
  BrokerSettings broker = settings_;
  broker.others.clear();
  broker.host = place().address.host;
  broker.port = place().address.port;
  broker.tls = place().address.tls;
  broker.client_id = client_id_at(at_, broker.client_id);
  return broker;
}

std::string Upstream::common_uri() const {
  return (settings_.is_cluster ? settings_ : broker()).addresses().front().uri();
}

void Upstream::stop() {
  reconnect_timer_.cancel();
  stall_timer_.cancel();
  drop_link(true);
  if (scout_) scout_->stop();  // its destructor joins the thread: a probe may take long
  lane_.join();
}

void Upstream::reconfigure(const BrokerSettings& settings) {
  if (settings == settings_) return;
  if (settings.addresses().front() != place().address) publish_will();
  settings_ = settings;
  make_places();
  backoff_.reset();
  const bool was_up = is_up_;
  drop_link(true);
  if (was_up) listener_.on_link_left("the configuration has changed");
  connect_in(Duration::zero());
}

void Upstream::retry_now() {
  if (!is_waiting_) return;
  backoff_.reset();
  connect_in(network_settles);
}

/// Looks the name up and reads the TLS files each time, because they may have changed.
void Upstream::connect() {
  is_waiting_ = false;
  if (read_credentials_) settings_.credentials = read_credentials_();
  look_up_ = std::make_shared<const bool>(true);
  boost::asio::post(lane_, [this, broker = broker(), asked = std::weak_ptr(look_up_),
                            busy = boost::asio::make_work_guard(io_)] {
    if (asked.expired()) return;
    boost::asio::post(io_, [this, asked, way = find_broker(broker)] {
      if (!asked.expired()) connect_by(way);
    });
  });
}

void Upstream::connect_by(WayToBroker way) {
  look_up_.reset();
  way_ = std::move(way);
  if (!way_.problem.empty()) return on_connect_failed({0, way_.problem});
  const auto timeout = places_.size() > 1 ? connect_timeout_of_many : connect_timeout;
  link_ = traits_.make_link(
      io_, lane_,
      {broker(), way_, version(), place().will, timeout, place().attempt++,
       std::bind_front(&UpstreamListener::on_message, &listener_), traits_.max_inbound_octets},
      *this);
  link_->connect();
}

void Upstream::connect_in(Duration wait) {
  is_waiting_ = true;
  reconnect_timer_.after(wait, [this] {
    if (is_waiting_) connect();
  });
}

void Upstream::drop_link(bool is_orderly) {
  is_up_ = false;
  look_up_.reset();
  stall_watch_.on_link_down();
  stall_timer_.cancel();
  return_timer_.cancel();
  if (!link_) return;
  inbound_dropped_ += link_->inbound_dropped();
  std::exchange(link_, nullptr)->abandon(is_orderly);
}

/// Connects to the next broker: at once, until all were tried; then after a pause. `least`: a pause
/// in any case.
void Upstream::go_on(const std::string& why, Duration least) {
  drop_link(false);
  std::string words = why;
  if (places_.size() > 1)
    words = fmt::format("{} port {}: {}", place().address.host, place().address.port, why);
  at_ = (at_ + 1) % places_.size();
  const double jitter = random_jitter();
  Duration wait = std::chrono::duration_cast<Duration>(least * (0.5 + 0.5 * jitter));
  if (++tried_ >= places_.size()) {
    wait = std::max<Duration>(wait, backoff_.next_wait(jitter, std::chrono::steady_clock::now()));
    tried_ = 0;
  }
  connect_in(wait);
  listener_.on_link_down(words);
}

void Upstream::on_connected(const BrokerLimits& limits) {
  limits_ = limits;
  if (limits_.max_packet_bytes == 0) limits_.max_packet_bytes.reset();  // a protocol error
  limits_.max_qos = std::min(limits_.max_qos, place().max_qos);
  place().attempt = 0;
  place().version.on_connected();
  up_since_ = std::chrono::steady_clock::now();
  rivals_.on_up(up_since_);
  unanswered_.clear();
  last_answered_ = 0;
  answered_at_ = up_since_;
  trial_.reset();
  has_sent_qos_2_ = false;
  come_up();
}

std::chrono::seconds Upstream::keep_alive_in_use() const {
  const bool is_bounded = settings_.client == MqttClient::mosquitto;
  return is_bounded ? std::max(settings_.keep_alive, MosquittoLink::shortest_keep_alive)
                    : settings_.keep_alive;
}

void Upstream::come_up() {
  is_up_ = true;
  stall_watch_.on_link_up(keep_alive_in_use(), std::chrono::steady_clock::now());
  watch_for_stall();
  if (at_ != 0 && settings_.returns_to_first)
    probe_first_broker_in(
        return_backoff_.next_wait(random_jitter(), std::chrono::steady_clock::now()));
  listener_.on_link_up(limits_);
}

void Upstream::probe_first_broker_in(Duration wait) {
  return_timer_.after(wait, [this] { probe_first_broker(); });
}

/// Tries only the steps before MQTT: with our client id, a cluster would end the connection that is
/// up.
void Upstream::probe_first_broker() {
  BrokerSettings first = settings_;
  first.others.clear();
  if (!scout_) scout_.emplace(1);
  boost::asio::post(*scout_, [this, first, link = std::weak_ptr(link_)] {
    const bool is_well = probe_broker(first).is_reachable;
    boost::asio::post(io_, [this, is_well, link] {
      if (!is_up_ || link.expired() || link.lock() != link_) return;
      if (is_well) return return_to_first();
      return_backoff_.reset();
      probe_first_broker_in(
          return_backoff_.next_wait(random_jitter(), std::chrono::steady_clock::now()));
    });
  });
}

/// Publishes the last will at a broker that is left for another, because a clean DISCONNECT cancels
/// it. The outbox never uses the sequence number 0.
void Upstream::publish_will() {
  constexpr std::uint64_t no_sequence = 0;
  const LastWill& will = place().will;
  if (!will.topic.empty())
    publish(no_sequence, {will.topic, to_bytes(will.payload), will.qos, will.is_retained});
}

void Upstream::return_to_first() {
  publish_will();
  drop_link(true);
  at_ = 0;
  tried_ = 0;
  listener_.on_link_left("the first broker of the list takes connections again");
  connect_in(Duration::zero());
}

/// Returns a number in [0, 1).
double Upstream::random_jitter() { return std::uniform_real_distribution<double>(0, 1)(random_); }

void Upstream::on_connect_failed(ConnectFailure failure) {
  if (is_version_refusal(failure.code)) failure.answer = ConnectAnswer::version_refused;
  if (place().version.on_failed(failure.answer) || adapt_will(failure.code)) {
    drop_link(false);
    connect();
    return;
  }
  if (failure.code != 0) failure.text = explain_connect_failure(failure.code);
  if (is_not_authorised(failure.code)) failure.text += explain_credentials(settings_, traits_);
  go_on(failure.text, Duration::zero());
}

/// Removes the property for which the broker has refused the last will. Returns false when it was
/// refused for another reason, or the property is gone already.
bool Upstream::adapt_will(int code) {
  constexpr int retain_not_supported = 0x9a;
  constexpr int qos_not_supported = 0x9b;
  if (code == retain_not_supported) return std::exchange(place().will.is_retained, false);
  if (code == qos_not_supported)
    return std::exchange(place().will.qos, Qos::at_most_once) != Qos::at_most_once;
  return false;
}

/// Goes on to the next broker, and explains a likely rival. Two gateways with one client id end
/// each other's connections without end, and not every broker says so.
void Upstream::on_lost(std::string why, LossCause cause) {
  place().version.on_lost();
  const TimePoint now = std::chrono::steady_clock::now();
  if (now - up_since_ >= RivalWatch::stable_after) {
    backoff_.reset();
    if (at_ == 0) return_backoff_.reset();
    tried_ = 0;
  }
  if (cause == LossCause::misread && has_sent_qos_2_ && version() == MqttVersion::v3_1_1) {
    place().max_qos = Qos::at_least_once;
    why += ": the broker does not answer QoS 2 as MQTT wants; QoS 1 is used instead";
  }
  // Some brokers close the connection after a refusal. The outbox makes sure that this is rare.
  const bool is_for_a_message = now - refused_at_ < refusal_to_loss || trial_;
  if (is_for_a_message) backoff_.reset();
  const bool is_taken_over = cause == LossCause::taken_over;
  const bool is_no_rival = is_for_a_message || cause == LossCause::told || !unanswered_.empty();
  if (rivals_.on_lost(is_taken_over, is_no_rival, now) && !is_taken_over)
    why += fmt::format(" shortly after connecting, repeatedly; perhaps {}",
                       explain_rival(broker().client_id));
  go_on(why, rivals_.pause());
}

void Upstream::on_published(std::uint64_t sequence) {
  on_answered(sequence);
  listener_.on_published(sequence);
}

void Upstream::on_answered(std::uint64_t sequence) {
  if (trial_ == sequence) trial_.reset();
  if (unanswered_.erase(sequence) == 0) return;  // QoS 0
  last_answered_ = std::max(last_answered_, sequence);
  answered_at_ = std::chrono::steady_clock::now();
}

/// Returns true when the broker has skipped a message, or answers none. Brokers answer in order
/// (MQTT 5 section 4.6), so a broker that is only slow skips none.
bool Upstream::has_forgotten_a_message(TimePoint now) const {
  if (unanswered_.empty()) return false;
  const auto& [sequence, handed_over_at] = *unanswered_.begin();
  return now - handed_over_at >= traits_.longest_answer &&
         (last_answered_ > sequence || now - answered_at_ >= traits_.longest_answer);
}

void Upstream::on_publish_refused(std::uint64_t sequence, int code) {
  on_answered(sequence);
  refused_at_ = std::chrono::steady_clock::now();
  listener_.on_publish_refused(sequence, {code, explain_publish_refusal(code)});
}

void Upstream::on_subscribe_result(const std::string& filter, bool granted) {
  listener_.on_subscribe_result(filter, granted);
}

void Upstream::on_unsubscribed(const std::string& filter) {
  if (filter != question) return;
  const TimePoint now = std::chrono::steady_clock::now();
  const bool was_silent = stall_watch_.on_answer(now);
  if (has_forgotten_a_message(now))
    return on_lost(
        fmt::format("the broker has not answered one message for {} s, but has answered others",
                    traits_.longest_answer.count()),
        LossCause::unknown);
  watch_for_stall();  // the deadline may be earlier now
  if (was_silent) listener_.on_silence(false);
}

void Upstream::publish(std::uint64_t sequence, const BrokerMessage& message, bool is_trial) {
  if (!is_up_) return;
  std::optional<BrokerMessage> lowered;  // a copy only where the broker cannot take it as it is
  if (message.qos > limits_.max_qos || (message.retain && !limits_.keeps_retained)) {
    lowered = message;
    lowered->qos = std::min(message.qos, limits_.max_qos);
    lowered->retain = message.retain && limits_.keeps_retained;
  }
  const BrokerMessage& accepted = lowered ? *lowered : message;
  if (!fits_packet(sequence, accepted)) return;
  if (accepted.qos != Qos::at_most_once)
    unanswered_.emplace_hint(unanswered_.end(), sequence, std::chrono::steady_clock::now());
  if (is_trial) trial_ = sequence;
  has_sent_qos_2_ = has_sent_qos_2_ || accepted.qos == Qos::exactly_once;
  link_->publish(sequence, accepted);
  if (stall_watch_.on_sent()) watch_for_stall();
}

void Upstream::watch_for_stall() {
  const auto deadline = stall_watch_.deadline();
  if (!deadline) return;
  stall_timer_.at(*deadline, [this] {
    if (is_up_) on_stall_deadline(std::chrono::steady_clock::now());
    watch_for_stall();
  });
}

void Upstream::on_stall_deadline(TimePoint now) {
  switch (stall_watch_.on_deadline(now)) {
    case StallWatch::Step::none: return;
    case StallWatch::Step::ask: return link_->unsubscribe(question);
    case StallWatch::Step::silent: return listener_.on_silence(true);
    case StallWatch::Step::stalled:
      return on_lost(
          fmt::format("the broker has not answered for {} s", stall_watch_.patience().count()),
          LossCause::unknown);
  }
}

/// Returns false when the packet is too large for the broker. Refuses the message in the broker's
/// place, because brokers close the connection for such a packet.
bool Upstream::fits_packet(std::uint64_t sequence, const BrokerMessage& message) {
  if (!limits_.max_packet_bytes) return true;
  std::optional<std::size_t> property_bytes;
  if (version() == MqttVersion::v5)
    property_bytes = user_property_bytes(message, settings_.gateway_id);
  const std::size_t bytes = publish_packet_bytes(message, property_bytes);
  if (bytes <= *limits_.max_packet_bytes) return true;
  constexpr int packet_too_large = 0x95;
  Refusal refusal{packet_too_large,
                  fmt::format("the packet of {} octets exceeds the broker's limit of {}", bytes,
                              *limits_.max_packet_bytes)};
  boost::asio::post(io_, [this, sequence, refusal, link = std::weak_ptr(link_)] {
    if (!link.expired() && link.lock() == link_) listener_.on_publish_refused(sequence, refusal);
  });
  return false;
}

/// Answers in the place of a broker that would end the connection for the wildcard.
void Upstream::subscribe(const std::string& filter) {
  if (!is_up_) return;
  if (limits_.takes_wildcards || filter.find_first_of("+#") == std::string::npos)
    return link_->subscribe(filter);
  boost::asio::post(io_, [this, filter, link = std::weak_ptr(link_)] {
    if (!link.expired() && link.lock() == link_) listener_.on_subscribe_result(filter, false);
  });
}

void Upstream::unsubscribe(const std::string& filter) {
  if (is_up_) link_->unsubscribe(filter);
}

std::uint64_t Upstream::inbound_dropped() const {
  return inbound_dropped_ + (link_ ? link_->inbound_dropped() : 0);
}

}  // namespace slamgw
