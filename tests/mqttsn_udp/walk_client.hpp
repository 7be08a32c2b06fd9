// SPDX-License-Identifier: Apache-2.0
// A client that follows the specification, for the random walk: one request at a time, repeated
// until it is answered. It publishes and receives numbered messages, and sleeps now and then.
// An independent model: it shares only the codec with the gateway.
#pragma once

#include <map>
#include <optional>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/protocol/packet.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::mqttsn {

class WalkClient {
 public:
  WalkClient(std::string id, unsigned messages, std::uint64_t seed);

  /// Returns the packets that it sends now.
  std::vector<Packet> on_tick(TimePoint now);
  std::vector<Packet> on_packet(const Packet& packet, TimePoint now);
  /// Starts no new sleep from now on, and does not disconnect.
  void stay_awake() { may_sleep_ = false; }

  bool is_done() const { return published_.size() == messages_ && !request_ && !is_asleep_; }
  const std::string& id() const { return id_; }
  std::string up_topic() const { return "ntnu-slam/robot/" + id_ + "/n"; }
  std::string down_topic() const { return "w/" + id_ + "/n"; }

  struct Published {
    std::string payload;
    unsigned qos = 0;
    bool is_acknowledged = false;
  };
  const std::vector<Published>& published() const { return published_; }
  /// Payloads in the order of their first arrival, and how often each came.
  const std::vector<std::string>& taken() const { return taken_; }
  const std::map<std::string, unsigned>& times_taken() const { return times_taken_; }

 private:
  void next_request(TimePoint now);
  void ask(Packet packet, TimePoint now);
  void publish_next(TimePoint now);
  void take(const Publish& publish, std::vector<Packet>& out);
  bool is_answer(const Packet& packet) const;

  const std::string id_;
  const unsigned messages_;
  std::mt19937_64 random_;
  bool may_sleep_ = true;
  bool is_connected_ = false;
  bool is_asleep_ = false;
  bool is_subscribed_ = false;
  std::uint16_t topic_id_ = 0;
  std::uint16_t down_id_ = 0;
  std::uint16_t msg_id_ = 0;
  std::optional<Packet> request_;
  unsigned tries_ = 0;
  TimePoint repeat_at_{};
  TimePoint wake_at_{};
  std::vector<Published> published_;
  std::vector<std::string> taken_;
  std::map<std::string, unsigned> times_taken_;
  std::set<std::uint16_t> qos2_seen_;  // no MsgId comes twice in one walk
};

}  // namespace slamgw::mqttsn
