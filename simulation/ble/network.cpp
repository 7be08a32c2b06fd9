// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/network.hpp"

#include <algorithm>

namespace slamgw::sim::ble {
namespace {

Key to_key(const Bytes& octets) {
  Key key{};
  std::copy_n(octets.begin(), std::min(octets.size(), key.size()), key.begin());
  return key;
}

RobotSettings settings_of(const BleOptions& options, unsigned number) {
  RobotSettings settings;
  settings.address = static_cast<Address>(first_robot + number - 1);
  settings.ttl = static_cast<std::uint8_t>(std::max<unsigned>(default_ttl, options.hops));
  settings.is_acknowledged = options.is_acknowledged;
  settings.is_unicast = options.is_unicast;
  settings.has_segment_timing = options.has_segment_timing;
  settings.obeys = options.common.obeys;
  settings.messages = options.common.limit();
  settings.period = options.common.period();
  return settings;
}

}  // namespace

Network::Network(const BleOptions& options)
    : board_({options.common.robots, options.has_segment_timing}),
      radio_({options.common.loss, options.hops},
             Random(options.common.seed, 0, Random::Use::radio)) {
  if (options.is_configured) board_.configure(to_key(options.net_key), to_key(options.app_key));
  for (unsigned number = 1; number <= options.common.robots; ++number) {
    robots_.emplace_back(settings_of(options, number), RobotBody(options.common.seed, number));
  }
}

void Network::on_start(TimePoint now) {
  board_.on_power_up(now);
  for (Robot& robot : robots_) robot.on_start(now);
}

void Network::on_host_bytes(ByteView bytes, TimePoint now) {
  board_.on_host_bytes(bytes, now);
  carry(now);
}

TimePoint Network::deadline() const {
  std::optional<TimePoint> next = first_of(radio_.next_arrival(), board_.deadline());
  for (const Robot& robot : robots_) next = first_of(next, robot.deadline());
  return next.value_or(TimePoint::max());
}

void Network::on_deadline(TimePoint now) {
  if (std::optional<Reception> reception = radio_.take(now)) {
    deliver(*reception, now);
  } else if (const auto due = board_.deadline(); due && *due <= now) {
    board_.on_deadline(now);
  } else {
    const auto first = std::min_element(
        robots_.begin(), robots_.end(),
        [](const Robot& a, const Robot& b) { return a.deadline() < b.deadline(); });
    if (first == robots_.end() || first->deadline() > now) return;
    first->on_deadline(gateway_for(*first, now), now);
  }
  carry(now);
}

Robot::Gateway Network::gateway_for(const Robot& robot, TimePoint now) {
  const Address destination = robot.update_destination(board_.local_address());
  if (!has_begun_) has_begun_ = board_.is_ready_for(destination, now);
  return {has_begun_ && board_.hears(destination), board_.local_address()};
}

void Network::deliver(const Reception& reception, TimePoint now) {
  const MeshMessage& message = reception.message;
  const auto index = static_cast<std::size_t>(message.destination - first_robot);
  const bool is_for_robot = message.destination >= first_robot && index < robots_.size();
  if (is_for_robot) {
    robots_[index].on_message(message, now);
  } else if (message.source != board_.local_address()) {
    board_.on_radio(reception);
  }
}

void Network::carry(TimePoint now) {
  while (auto message = board_.next_transmission()) radio_.transmit(std::move(*message), now);
  for (Robot& robot : robots_) {
    while (auto outgoing = robot.next_transmission()) {
      const bool is_on_its_way = radio_.transmit(std::move(outgoing->message), now);
      if (!is_on_its_way && outgoing->is_unacknowledged_update) robot.on_update_dropped();
    }
  }
}

bool Network::has_sent_everything() const {
  return radio_.is_silent() && std::all_of(robots_.begin(), robots_.end(), [](const Robot& robot) {
           return robot.has_sent_everything();
         });
}

}  // namespace slamgw::sim::ble
