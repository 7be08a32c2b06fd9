// SPDX-License-Identifier: Apache-2.0
// CONNECT and the will handshake (MQTT-SN 1.2 sections 6.2, 6.3): until a handshake is complete no
// session is touched.
#pragma once

#include <map>
#include <unordered_map>

#include "adapters/mqttsn_udp/conversations/discovery.hpp"
#include "adapters/mqttsn_udp/conversations/lifecycle.hpp"

namespace slamgw::mqttsn {

class Connecting : Conversation {
 public:
  Connecting(const Conversation& common, Lifecycle& lifecycle, Downlink& downlink, Wills& wills,
             FloodGuard& guard)
      : Conversation(common),
        lifecycle_(lifecycle),
        downlink_(downlink),
        wills_(wills),
        guard_(guard) {}

  void on_connect(const Arrival& arrival, const Connect& connect);
  bool is_open(const Peer& peer) const { return attempts_.contains(peer); }
  /// Call these only while a handshake is open. WILLMSG before WILLTOPIC ends it (R29).
  void on_willtopic(const Arrival& arrival, const WillTopic& will);
  void on_willmsg(const Arrival& arrival, WillMsg will);
  /// Handles a WILLMSG after the handshake. If nothing else was heard since, the CONNACK was lost
  /// and is sent again.
  void on_late_willmsg(const ClientSession& session, const WillMsg& will, TimePoint now);
  /// Forgets the attempt and answers with DISCONNECT (R29).
  void abandon(const Peer& peer);

  std::optional<TimePoint> deadline() const { return timers_.earliest(); }
  void on_deadline(TimePoint now);

 private:
  enum class Stage : std::uint8_t { topic, message };
  struct Attempt {
    LocalAddress local;
    Connect connect;
    std::string robot;
    std::uint64_t fingerprint = 0;
    Stage stage = Stage::topic;
    Will will;
    unsigned repeats = 0;
    std::optional<TimePoint> armed;
    std::uint64_t stranger = 0;  // key in strangers_; 0: the client has a session here
  };

  bool is_repetition(const Arrival& arrival, const Connect& connect) const;
  void begin(const Arrival& arrival, Attempt attempt);
  void prompt(const Peer& peer, Attempt& attempt, TimePoint now);
  Attempt take(const Peer& peer);
  bool make_room();
  void complete(const Arrival& arrival, const Attempt& attempt, std::optional<Will> will);
  void on_takeover(ClientSession& session, const Peer& peer, TimePoint now);
  void refuse_name(const Arrival& arrival, const Connect& connect);
  void answer_refused(const Arrival& arrival, ReturnCode code);
  void refuse_for_place(const Arrival& arrival);
  void refuse_for_room(const Arrival& arrival, const std::string& why);

  Lifecycle& lifecycle_;
  Downlink& downlink_;
  Wills& wills_;
  FloodGuard& guard_;
  std::unordered_map<Peer, Attempt, PeerHash> attempts_;  // at most max_handshakes
  std::map<std::uint64_t, Peer> strangers_;  // attempts whose client has no session; oldest first
  std::uint64_t last_stranger_ = 0;
  TimerQueue<Peer> timers_;
  TokenBucket contest_lines_[2];  // index: whether the client is proven
};

}  // namespace slamgw::mqttsn
