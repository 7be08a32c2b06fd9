// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/robot/heartbeats.hpp"

#include <algorithm>
#include <bit>

namespace slamgw::sim::ble {
namespace {

constexpr std::uint16_t heartbeat_publication_op = 0x06;
constexpr std::uint16_t heartbeat_subscription_op = 0x803c;
constexpr std::size_t heartbeat_publication_octets = 9;
constexpr std::size_t heartbeat_subscription_octets = 5;

constexpr std::uint8_t max_count_log = 0x10;
constexpr std::uint8_t max_period_log = 0x11;
constexpr std::uint8_t endless_count_log = 0xff;
constexpr std::uint32_t endless_count = 0xffff;
constexpr std::uint32_t max_count = 1U << (max_count_log - 1U);
constexpr std::uint8_t max_heartbeat_ttl = 127;
constexpr std::uint16_t known_features = 0x000f;

bool is_virtual_address(Address address) { return address >= 0x8000 && address <= 0xbfff; }

/// Returns nothing for a prohibited log.
std::optional<std::uint32_t> from_log(std::uint8_t log, std::uint8_t max_log) {
  if (log > max_log) return std::nullopt;
  return log == 0 ? 0U : 1U << (log - 1U);
}

/// Returns the largest power of two that is not above the value.
std::uint8_t floor_log(std::uint32_t value) {
  return static_cast<std::uint8_t>(std::bit_width(value));
}

/// Returns the smallest power of two that is not below the value.
std::uint8_t publication_count_log(std::uint32_t count) {
  if (count == endless_count) return endless_count_log;
  if (count <= 1) return static_cast<std::uint8_t>(count);
  return static_cast<std::uint8_t>(std::bit_width(count - 1) + 1);
}

}  // namespace

std::optional<Answer> Heartbeats::on_message(ByteView message,
                                             const NodeConfiguration& configuration,
                                             TimePoint now) {
  using Self = Heartbeats;
  static constexpr ConfigRequest<Self> requests[] = {
      {0x8038, &Self::publication_get},
      {0x8039, &Self::publication_set},
      {0x803a, &Self::subscription_get},
      {0x803b, &Self::subscription_set},
  };
  const auto opcode = two_octet_opcode(message);
  if (!opcode) return std::nullopt;
  configuration_ = &configuration;
  now_ = now;
  return answer_request(requests, *this, *opcode, message.subspan(2));
}

// --- Publishing ----------------------------------------------------------------------------------

Answer Heartbeats::publication_get(ByteView parameters) {
  if (!parameters.empty()) return std::nullopt;
  Bytes out = begin_status(heartbeat_publication_op, ConfigStatus::success);
  put_u16_le(out, publication_.destination);
  put(out, Bytes{publication_count_log(publication_.count), floor_log(publication_.period_s),
                 publication_.ttl});
  put_u16_le(out, publication_.features);
  put_u16_le(out, publication_.net_key_index);
  return out;
}

/// The answer repeats the request, with any status.
Answer Heartbeats::publication_set(ByteView parameters) {
  if (parameters.size() != heartbeat_publication_octets) return std::nullopt;
  const Address destination = get_u16_le(parameters, 0);
  const auto count = parameters[2] == endless_count_log ? std::optional(endless_count)
                                                        : from_log(parameters[2], max_count_log);
  const auto period_s = from_log(parameters[3], max_period_log);
  const std::uint8_t ttl = parameters[4];
  const auto features = static_cast<std::uint16_t>(get_u16_le(parameters, 5) & known_features);
  const std::uint16_t net_key_index = get_u16_le(parameters, 7);
  auto status = ConfigStatus::success;
  if (configuration_->find_net_key(net_key_index) == nullptr) {
    status = ConfigStatus::invalid_net_key_index;
  } else if (is_virtual_address(destination) || !count || !period_s || ttl > max_heartbeat_ttl) {
    status = ConfigStatus::cannot_set;
  } else {
    publication_ = {destination, *count, *period_s, ttl, features, net_key_index};
    if (destination == 0) publication_ = {0, 0, 0, 0, features, net_key_index};
    start();
  }
  if (failed_assertion_) return std::nullopt;
  Bytes out = begin_status(heartbeat_publication_op, status);
  put(out, parameters.first(5));
  put_u16_le(out, features);
  put_u16_le(out, net_key_index);
  return out;
}

/// Up to 3.0 the first one waits in a list of event handlers until a message has left, and nothing
/// may be put into that list twice. Later releases send it at once.
void Heartbeats::start() {
  next_at_.reset();
  if (publication_.count == 0 || publication_.period_s == 0) return;
  if (!firmware_->first_heartbeat_waits) {
    next_at_ = now_;
    return;
  }
  if (waits_for_transmission_) failed_assertion_ = "an event handler is added twice";
  waits_for_transmission_ = true;
  next_at_ = now_ + std::chrono::seconds{publication_.period_s};
}

void Heartbeats::on_transmitted() {
  if (std::exchange(waits_for_transmission_, false)) publish();
}

void Heartbeats::on_deadline(TimePoint now) {
  if (!next_at_ || *next_at_ > now) return;
  next_at_ = *next_at_ + std::chrono::seconds{publication_.period_s};
  publish();
}

void Heartbeats::publish() {
  if (publication_.count == 0) {
    next_at_.reset();
    return;
  }
  if (publication_.count != endless_count) --publication_.count;
  next_ = Heartbeat{publication_.destination, publication_.ttl};
}

// --- Counting ------------------------------------------------------------------------------------

Answer Heartbeats::subscription_get(ByteView parameters) {
  if (!parameters.empty()) return std::nullopt;
  if (subscription_.source != 0) return subscription_status();
  Bytes out = begin_status(heartbeat_subscription_op, ConfigStatus::success);
  put(out, Bytes(8, 0));
  return out;
}

/// Does not answer an invalid subscription. The count stays when it is switched off.
Answer Heartbeats::subscription_set(ByteView parameters) {
  if (parameters.size() != heartbeat_subscription_octets) return std::nullopt;
  const Address source = get_u16_le(parameters, 0);
  const Address destination = get_u16_le(parameters, 2);
  const auto period_s = from_log(parameters[4], max_period_log);
  const bool is_source = source == 0 || is_unicast(source);
  const bool is_destination =
      destination == 0 || is_group(destination) || destination == configuration_->network->address;
  if (!period_s || !is_source || !is_destination) return std::nullopt;
  if (*period_s == 0 || source == 0 || destination == 0) {
    subscription_.source = 0;
    subscription_.destination = 0;
    counts_until_ = now_;
  } else {
    subscription_ = {source, destination};
    counts_until_ = now_ + std::chrono::seconds{*period_s};
  }
  return subscription_status();
}

Bytes Heartbeats::subscription_status() const {
  Bytes out = begin_status(heartbeat_subscription_op, ConfigStatus::success);
  put_u16_le(out, subscription_.source);
  put_u16_le(out, subscription_.destination);
  put(out, Bytes{floor_log(seconds_left()), floor_log(subscription_.count), subscription_.min_hops,
                 subscription_.max_hops});
  return out;
}

std::uint32_t Heartbeats::seconds_left() const {
  if (counts_until_ <= now_) return 0;
  const auto left = std::chrono::ceil<std::chrono::seconds>(counts_until_ - now_);
  return static_cast<std::uint32_t>(left.count());
}

/// Returns true if the network layer accepts the destination. Up to 3.0 a heartbeat subscription
/// does not subscribe to its group.
bool Heartbeats::hears(Address destination, const NodeConfiguration& configuration) const {
  if (destination == all_nodes) return true;
  if (is_unicast(destination)) return destination == configuration.network->address;
  const auto is_subscribed = [&](const Model& model) {
    const auto& groups = model.subscriptions;
    return std::find(groups.begin(), groups.end(), destination) != groups.end();
  };
  return (!firmware_->first_heartbeat_waits && destination == subscription_.destination) ||
         std::any_of(configuration.models.begin(), configuration.models.end(), is_subscribed);
}

void Heartbeats::on_heartbeat(Address source, Address destination, std::uint8_t hops,
                              TimePoint now) {
  if (source != subscription_.source || destination != subscription_.destination) return;
  if (now >= counts_until_) return;
  subscription_.count = std::min(subscription_.count + 1, max_count);
  subscription_.min_hops = std::min(subscription_.min_hops, hops);
  subscription_.max_hops = std::max(subscription_.max_hops, hops);
}

}  // namespace slamgw::sim::ble
