// SPDX-License-Identifier: Apache-2.0
// Messages on their way to one client: REGISTER where needed, PUBLISH, the acknowledgements,
// repetition, and the awake window of a sleeping client (MQTT-SN 1.2 sections 6.6, 6.10, 6.13,
// 6.14). One exchange at a time for each client, each client by itself (R66, R91, R147).
#pragma once

#include <string>

#include "adapters/mqttsn_udp/context.hpp"
#include "adapters/mqttsn_udp/conversations/command_watch.hpp"
#include "adapters/mqttsn_udp/conversations/subscriptions.hpp"
#include "daemon/core/burst.hpp"

namespace slamgw::mqttsn {

class Downlink {
 public:
  Downlink(Context& context, Subscriptions& subscriptions, CommandWatch& commands)
      : context_(context), subscriptions_(subscriptions), commands_(commands) {}

  /// Takes the message, or says why not, and sends what may be sent.
  void enqueue(ClientSession& session, Outgoing outgoing, TimePoint now);
  /// Sends what may be sent now; ends an awake window that has nothing left to do.
  void pump(ClientSession& session, TimePoint now);

  void on_regack(ClientSession& session, const Regack& regack, TimePoint now);
  void on_puback(ClientSession& session, const Puback& puback, TimePoint now);
  void on_pubrec(ClientSession& session, const Pubrec& pubrec, TimePoint now);
  void on_pubcomp(ClientSession& session, const Pubcomp& pubcomp, TimePoint now);

  /// A sign of life: what rested for want of an answer goes on at the next pump (R133).
  void on_heard(ClientSession& session);
  /// PINGREQ of a sleeping client (R118).
  void wake(ClientSession& session, TimePoint now);
  /// From now on nothing is sent; what is in flight is kept (R116).
  void rest(ClientSession& session);
  void drop_all(ClientSession& session, const std::string& why, TimePoint now);
  /// QoS 0 does not outlive the connection.
  void drop_volatile(ClientSession& session, const std::string& why, TimePoint now);
  /// The daemon ends: from now on refuse_unkept() follows each message.
  void on_stop() { is_stopping_ = true; }
  /// What could not be sent and no snapshot keeps (QoS 0) is refused; nothing is sent any more.
  void refuse_unkept(ClientSession& session, TimePoint now);
  /// What no subscription asks for any more (R104).
  void drop_unwanted(ClientSession& session, TimePoint now);

  std::optional<TimePoint> next_time(const ClientSession& session) const;
  void on_time(ClientSession& session, TimePoint now);

 private:
  bool may_send(const ClientSession& session) const;
  void start_next(ClientSession& session, TimePoint now);
  std::optional<std::uint16_t> topic_id(ClientSession& session, const Outgoing& outgoing);
  void publish(ClientSession& session, Outgoing outgoing, std::uint16_t topic_id, TimePoint now);
  void resume(ClientSession& session, TimePoint now);
  void transmit(ClientSession& session, TimePoint now);
  Packet packet_in_flight(const ClientSession& session) const;
  void finish_wake(ClientSession& session, TimePoint now);
  void finish(ClientSession& session, CommandResult result, std::string why, TimePoint now);
  void register_again(ClientSession& session, Outgoing outgoing, std::uint16_t topic_id);
  void pause(ClientSession& session, TimePoint now);
  void give_up(ClientSession& session, TimePoint now);
  void keep_in_bounds(ClientSession& session, TimePoint now);
  bool is_too_large(const ClientSession& session, const Outgoing& outgoing, TimePoint now);
  void refuse(const Outgoing& outgoing, std::string why, TimePoint now);
  template <class Predicate>
  void drop_if(ClientSession& session, const std::string& why, TimePoint now, Predicate is_dropped);
  static void push_front(Delivery& delivery, Outgoing outgoing);
  static Outgoing take(Delivery& delivery, std::size_t index);
  static std::uint16_t next_msg_id(Delivery& delivery);

  Context& context_;
  Subscriptions& subscriptions_;
  CommandWatch& commands_;
  bool is_stopping_ = false;
  Burst too_large_;
};

}  // namespace slamgw::mqttsn
