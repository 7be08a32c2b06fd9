// SPDX-License-Identifier: Apache-2.0
#include "tests/mqttsn_udp/walk_client.hpp"

#include <utility>

namespace slamgw::mqttsn {
namespace {

using std::chrono::seconds;

constexpr seconds repeat_interval{5};
/// Repeats of QoS 1 stay well inside the gateway's window (R76), delays included.
constexpr unsigned max_tries_qos1 = 4;

}  // namespace

WalkClient::WalkClient(std::string id, unsigned messages, std::uint64_t seed)
    : id_(std::move(id)), messages_(messages), random_(seed) {}

std::vector<Packet> WalkClient::on_tick(TimePoint now) {
  if (is_asleep_ && !request_ && now >= wake_at_) ask(Pingreq{id_}, now);
  if (!request_ && !is_asleep_) next_request(now);
  if (!request_ || now < repeat_at_) return {};
  const auto* publish = std::get_if<Publish>(&*request_);
  if (publish && publish->qos == WireQos::one && tries_ >= max_tries_qos1) {
    request_.reset();  // it is unknown whether it went up
    return {};
  }
  ++tries_;
  repeat_at_ = now + repeat_interval;
  return {*request_};
}

void WalkClient::next_request(TimePoint now) {
  if (!is_connected_) return ask(Connect{false, false, protocol_id, 600, id_}, now);
  if (topic_id_ == 0) return ask(Register{0, ++msg_id_, up_topic()}, now);
  if (!is_subscribed_)
    return ask(Subscribe{false, WireQos::two, TopicIdType::normal, ++msg_id_, down_topic(), 0},
               now);
  if (may_sleep_ && random_() % 4 == 0) return ask(Disconnect{60}, now);
  if (published_.size() < messages_) publish_next(now);
}

void WalkClient::publish_next(TimePoint now) {
  const unsigned qos = 1 + static_cast<unsigned>(random_() % 2);
  const std::string payload = id_ + "#" + std::to_string(published_.size());
  published_.push_back({payload, qos, false});
  ask(Publish{false, static_cast<WireQos>(qos), false, TopicIdType::normal, topic_id_, ++msg_id_,
              to_bytes(payload)},
      now);
}

void WalkClient::ask(Packet packet, TimePoint now) {
  request_ = std::move(packet);
  tries_ = 0;
  repeat_at_ = now;
}

bool WalkClient::is_answer(const Packet& packet) const {
  if (!request_) return false;
  const auto has_id = [&](const auto& request, auto msg_id) { return request.msg_id == msg_id; };
  if (std::holds_alternative<Connect>(*request_)) return std::holds_alternative<Connack>(packet);
  if (std::holds_alternative<Pingreq>(*request_)) return std::holds_alternative<Pingresp>(packet);
  if (std::holds_alternative<Disconnect>(*request_))
    return std::holds_alternative<Disconnect>(packet);
  if (const auto* p = std::get_if<Register>(&*request_))
    return std::holds_alternative<Regack>(packet) && has_id(*p, std::get<Regack>(packet).msg_id);
  if (const auto* p = std::get_if<Subscribe>(&*request_))
    return std::holds_alternative<Suback>(packet) && has_id(*p, std::get<Suback>(packet).msg_id);
  if (const auto* p = std::get_if<Pubrel>(&*request_))
    return std::holds_alternative<Pubcomp>(packet) && has_id(*p, std::get<Pubcomp>(packet).msg_id);
  const auto* p = std::get_if<Publish>(&*request_);
  if (!p) return false;
  if (p->qos == WireQos::one)
    return std::holds_alternative<Puback>(packet) && has_id(*p, std::get<Puback>(packet).msg_id);
  return std::holds_alternative<Pubrec>(packet) && has_id(*p, std::get<Pubrec>(packet).msg_id);
}

std::vector<Packet> WalkClient::on_packet(const Packet& packet, TimePoint now) {
  std::vector<Packet> out;
  if (const auto* p = std::get_if<Register>(&packet)) {
    down_id_ = p->topic_id;
    out.push_back(Regack{p->topic_id, p->msg_id, ReturnCode::accepted});
  } else if (const auto* publish = std::get_if<Publish>(&packet)) {
    take(*publish, out);
  } else if (const auto* pubrel = std::get_if<Pubrel>(&packet)) {
    out.push_back(Pubcomp{pubrel->msg_id});
  } else if (is_answer(packet)) {
    const Packet request = *std::exchange(request_, std::nullopt);
    if (std::holds_alternative<Connect>(request)) is_connected_ = true;
    if (std::holds_alternative<Register>(request)) topic_id_ = std::get<Regack>(packet).topic_id;
    if (std::holds_alternative<Subscribe>(request)) is_subscribed_ = true;
    if (std::holds_alternative<Disconnect>(request) ||
        (std::holds_alternative<Pingreq>(request) && may_sleep_ && random_() % 2 == 0)) {
      is_asleep_ = true;
      wake_at_ = now + seconds(20);
    } else if (std::holds_alternative<Pingreq>(request)) {
      is_asleep_ = false;  // CONNECT makes it active again
      is_connected_ = false;
    } else if (std::holds_alternative<Pubrel>(request) || std::holds_alternative<Puback>(packet)) {
      published_.back().is_acknowledged = true;
    } else if (const auto* pubrec = std::get_if<Pubrec>(&packet)) {
      ask(Pubrel{pubrec->msg_id}, now);
    }
  }
  return out;
}

void WalkClient::take(const Publish& publish, std::vector<Packet>& out) {
  bool is_new = true;
  if (publish.qos == WireQos::one) {
    out.push_back(Puback{publish.topic_id, publish.msg_id, ReturnCode::accepted});
  } else if (publish.qos == WireQos::two) {
    out.push_back(Pubrec{publish.msg_id});
    is_new = qos2_seen_.insert(publish.msg_id).second;
  }
  if (!is_new) return;
  const std::string payload(as_text(publish.payload));
  if (++times_taken_[payload] == 1) taken_.push_back(payload);
}

}  // namespace slamgw::mqttsn
