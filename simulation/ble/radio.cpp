// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/radio.hpp"

#include <algorithm>
#include <cmath>

namespace slamgw::sim::ble {

std::vector<bool> Radio::transmit(const MeshMessage& message,
                                  const std::vector<Receiver>& receivers, TimePoint now) {
  std::vector<bool> reached;
  std::optional<Duration> sending;  // the time on the air, the same for all receivers
  for (const Receiver& receiver : receivers) {
    const bool is_lost = loses_message() || (receiver.loss > 0 && random_.chance(receiver.loss));
    const int rssi = rssi_dbm(message.source) + receiver.level_db;
    // Relays forward only TTL 2 and above (Mesh Profile 3.4.5.2).
    const bool is_too_far = settings_.hops > 1 && message.ttl < settings_.hops;
    reached.push_back(!is_lost && !is_too_far && in_flight_.size() < max_in_flight);
    if (!reached.back()) continue;

    const auto segments = static_cast<unsigned>(segment_count(message.payload.size()));
    if (!sending) sending = time_of_segments(message.source, segments, now);
    TimePoint& last = last_arrival_[{message.source, receiver.address}];
    last = std::max(last, now + *sending + travel_time());
    const auto ttl = static_cast<std::uint8_t>(message.ttl - (settings_.hops - 1));
    in_flight_.emplace(last,
                       Reception{message, ttl, static_cast<std::int8_t>(std::clamp(rssi, -127, 20)),
                                 receiver.board});
  }
  return reached;
}

bool Radio::loses_message() {
  double passes = 1;
  for (const double loss : settings_.hop_loss) passes *= 1 - loss;
  return random_.chance(1 - passes);
}

/// Returns a delay from half to one and a half times its mean.
Duration Radio::travel_time() {
  if (settings_.hop_delay.empty()) return hop_time * settings_.hops;
  Duration time{};
  for (const Duration mean : settings_.hop_delay) {
    time += std::chrono::duration_cast<Duration>(mean * (0.5 + random_.unit()));
  }
  return time;
}

/// Returns the time until the last segment leaves the source, after its earlier transmissions.
Duration Radio::time_of_segments(Address source, unsigned segments, TimePoint now) {
  if (settings_.bearer_interval == Duration{}) return segment_time * (segments - 1);
  TimePoint& next = next_packet_[source];
  const TimePoint first = std::max(next, now);
  next = first + settings_.bearer_interval * segments;
  return first - now + settings_.bearer_interval * (segments - 1);
}

std::int8_t Radio::rssi_dbm(Address transmitter) {
  const int level = -50 - transmitter * 7 % 30;
  return static_cast<std::int8_t>(level + 3 - static_cast<int>(random_.below(7)));
}

std::optional<TimePoint> Radio::next_arrival() const {
  if (in_flight_.empty()) return std::nullopt;
  return in_flight_.begin()->first;
}

std::optional<Reception> Radio::take(TimePoint now) {
  if (in_flight_.empty() || in_flight_.begin()->first > now) return std::nullopt;
  Reception first = std::move(in_flight_.begin()->second);
  in_flight_.erase(in_flight_.begin());
  return first;
}

}  // namespace slamgw::sim::ble
