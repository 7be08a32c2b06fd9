// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/robots/relay.hpp"

#include <algorithm>
#include <boost/crc.hpp>
#include <utility>

#include "daemon/core/normalizer.hpp"

namespace slamgw::ble {

namespace {

constexpr std::string_view relayed_type = "update";

bool is_in_segments(const Bytes& access) { return segments_of(access.size()) > 1; }

}  // namespace

std::uint16_t relayed_number_of(std::string_view robot) {
  boost::crc_optimal<16, 0x1021, 0xffff, 0, false, false> crc;
  crc.process_bytes(robot.data(), robot.size());
  return crc.checksum();
}

void Relay::on_robot_message(const BrokerMessage& message, TimePoint now) {
  // A retained message may be old. A guest leaves relaying to the gateway that configures the
  // robots; otherwise they would hear everything twice.
  if (message.retain || nodes_.is_guest()) return;
  const auto topic = topics_.parse_robot_topic(message.topic);
  if (topic && !is_for_others(topic->robot)) return;
  const bool is_update =
      topic && topic->type == relayed_type && parse_update(message.payload).has_value();
  if (!is_update || !link_.is_up) {
    ++counters_.dropped;
    return;
  }
  keep_last(topic->robot, message.payload);
  send_due(now);
}

/// Robots of this mesh are never echoed into it, online or not. Banned robots are not relayed.
bool Relay::is_for_others(std::string_view robot) const {
  return robots_.find(robot) == nullptr && !nodes_.names().bans().has(robot);
}

void Relay::keep_last(std::string_view robot, ByteView update) {
  const std::uint16_t sender = relayed_number_of(robot);
  Bytes access = encode_relayed_update(sender, update);
  const auto older = std::ranges::find(waiting_, sender, &Waiting::sender);
  if (older != waiting_.end()) {
    ++counters_.superseded;
    older->robot = robot;
    older->access = std::move(access);
  } else if (waiting_.size() >= max_senders) {
    ++counters_.dropped;
  } else {
    waiting_.push_back({sender, std::string(robot), std::move(access)});
  }
}

void Relay::on_link_down() {
  counters_.dropped += waiting_.size();
  waiting_.clear();
}

TimePoint Relay::due(const Waiting& update) const {
  return is_in_segments(update.access) ? std::max(next_at_, next_segmented_at_) : next_at_;
}

std::optional<TimePoint> Relay::deadline() const {
  std::optional<TimePoint> next;
  for (const Waiting& update : waiting_) next = earlier(next, due(update));
  return next;
}

/// Sends one update, of the sender whose turn it is. Acknowledgements and commands go first.
void Relay::send_due(TimePoint now) {
  const auto next =
      std::ranges::find_if(waiting_, [&](const Waiting& update) { return now >= due(update); });
  if (next == waiting_.end()) return;
  next_at_ = now + pause;
  if (!radio_.is_idle()) return;
  if (is_in_segments(next->access)) next_segmented_at_ = now + segmented_pause;
  ++counters_.relayed;
  if (is_traced_)
    emit(MessageStep{.kind = StepKind::sent,
                     .mesh = Mesh::ble,
                     .robot = next->robot,
                     .address = address_text(settings_.relay_group),
                     .topic = topics_.robot_topic(next->robot, relayed_type),
                     .bytes = next->access.size()});
  radio_.send({.destination = settings_.relay_group, .payload = std::move(next->access)}, now);
  waiting_.erase(next);
}

}  // namespace slamgw::ble
