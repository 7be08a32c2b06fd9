// SPDX-License-Identifier: Apache-2.0
// Messages on their way to one client: the queue, PUBLISH, its acknowledgement and repetition
// (MQTT-SN 1.2 sections 6.6, 6.10, 6.13). Each client has one PUBLISH of QoS 1 or 2 at a time,
// independent of other clients (R91, R147). Messages of one topic keep their order. An unanswered
// REGISTER or PUBREL holds others back for one wait at most. The outcome of each command is
// reported exactly once: when the robot has it, when it can't get it, or when its time is over.
#pragma once

#include <memory>
#include <string>

#include "adapters/mqttsn_udp/clients/delivery.hpp"
#include "adapters/mqttsn_udp/conversations/retransmission.hpp"
#include "adapters/mqttsn_udp/conversations/subscriptions.hpp"
#include "adapters/mqttsn_udp/conversations/topic_registration.hpp"
#include "daemon/core/log_throttle.hpp"

namespace slamgw::mqttsn {

class Downlink : Conversation {
 public:
  Downlink(const Conversation& common, Subscriptions& subscriptions, RandomSource random)
      : Conversation(common),
        subscriptions_(subscriptions),
        registration_(common),
        random_(std::move(random)) {}

  /// Queues the message, or refuses it with a reason. `pump()` sends it.
  void on_broker_message(ClientSession& session, const RobotMessage& incoming, TimePoint now);
  /// Refuses a command that no client can carry out. Does nothing when `id` is none.
  void refuse_command(const BrokerMessage& message, CommandId id, std::string why);
  /// Reports the outcome, unless it is reported already. `command` may be null.
  void end_command(const std::shared_ptr<Command>& command, CommandResult result, std::string why,
                   TimePoint now);
  /// Withdraws and reports commands whose time is over. Call before an answer of the client is
  /// handled: the timer may be late, and a late PUBREC gets no PUBREL.
  void expire_commands(ClientSession& session, TimePoint now);
  /// Expires commands, then sends what may be sent now.
  void pump(ClientSession& session, TimePoint now);

  void on_regack(ClientSession& session, const Regack& regack, TimePoint now);
  void on_puback(ClientSession& session, const Puback& puback, TimePoint now);
  void on_pubrec(ClientSession& session, const Pubrec& pubrec, TimePoint now);
  void on_pubcomp(ClientSession& session, const Pubcomp& pubcomp, TimePoint now);

  /// Call when the client has another address. If that is not validated, the client's first answer
  /// to a new request validates it.
  void on_address(ClientSession& session);
  /// Call for a PINGREQ that names the client: half a proof that its owner is at this address. A
  /// sender who knows the id can forge it, so it buys no octets; but QoS 0 no longer waits for an
  /// unanswered REGISTER.
  static void on_named_ping(ClientSession& session) { session.delivery.is_half_proven = true; }
  /// Call when the client is heard: deliveries that rest go on at the next pump (R133).
  void on_heard(ClientSession& session);
  /// Call when the client connects again within its session: it may have forgotten everything.
  void on_reconnect(ClientSession& session);
  /// Sends nothing more; messages that await an answer are kept (R116).
  void rest(ClientSession& session);
  /// Whether the client owes an answer. An awake client must go on listening then.
  bool is_awaiting(const ClientSession& session) const;

  /// Refuses all messages with `why`, and forgets requests that await an answer.
  void drop_all(ClientSession& session, const std::string& why, TimePoint now);
  /// Refuses messages of QoS 0, which do not outlive the connection.
  void drop_volatile(ClientSession& session, const std::string& why, TimePoint now);
  /// Refuses messages that only this filter asked for; the client no longer has it (R104).
  void drop_unwanted(ClientSession& session, const std::string& filter, TimePoint now);
  /// Call when another gateway serves the robot. Returns the messages that were never on the air;
  /// other commands end as `timeout`. The queue is empty afterwards.
  std::vector<WaitingMessage> take_unsent(ClientSession& session, TimePoint now);

  /// Call when the daemon stops. From now on refuse_unkept() follows each pump().
  void on_stop() { is_stopping_ = true; }
  /// Why commands are refused when the daemon stops.
  static constexpr const char* stopped = "the gateway stopped before the robot could take it";
  /// Stops sending, and refuses unsent messages that no snapshot keeps (QoS 0).
  void refuse_unkept(ClientSession& session, TimePoint now);

  /// Returns when a request is repeated or given up, a pause ends, or a command's time is over.
  std::optional<TimePoint> next_time(const ClientSession& session) const;
  /// Repeats requests that are due. Returns true if one was given up and the client sent nothing
  /// since it began.
  bool on_time(ClientSession& session, TimePoint now);

 private:
  std::shared_ptr<Command> begin_command(const ClientSession& session, const BrokerMessage& message,
                                         CommandId id, TimePoint now) const;
  void enqueue(ClientSession& session, Outgoing outgoing, TimePoint now);
  void time_out(ClientSession& session, const Outgoing& outgoing, std::string why, TimePoint now);
  bool may_send(const ClientSession& session) const;
  bool is_within_allowance(const ClientSession& session, const Outgoing& outgoing) const;
  void learn_from_answer(ClientSession& session, std::uint16_t msg_id, TimePoint now);
  void on_answer(ClientSession& session, std::uint16_t msg_id, bool is_asked, TimePoint now);
  bool send_next(ClientSession& session, TimePoint now);
  void resume_withheld(ClientSession& session, TimePoint now);
  void resume_releases(ClientSession& session, TimePoint now);
  bool repeat_releases(ClientSession& session, TimePoint now);
  void publish(ClientSession& session, Outgoing outgoing, TimePoint now);
  void repeat(ClientSession& session, Publishing& open);
  void transmit(ClientSession& session, const Outgoing& outgoing, std::uint16_t topic_id,
                std::uint16_t msg_id);
  void finish(ClientSession& session, const Outgoing& outgoing, CommandResult result,
              std::string why, TimePoint now);
  void register_again(ClientSession& session, Outgoing outgoing);
  void pause(ClientSession& session, TimePoint now);
  bool give_up(ClientSession& session, TimePoint now);
  void drop_unregistered(ClientSession& session, const std::string& topic, TimePoint now);
  void keep_in_bounds(ClientSession& session, TimePoint now);
  bool is_too_large(ClientSession& session, const Outgoing& outgoing, TimePoint now);
  void refuse(ClientSession& session, const Outgoing& outgoing, std::string why, TimePoint now);
  template <class Predicate>
  void drop_if(ClientSession& session, const std::string& why, TimePoint now, Predicate is_dropped);

  Subscriptions& subscriptions_;
  TopicRegistration registration_;
  RandomSource random_;
  bool is_stopping_ = false;
  LogThrottle too_large_;
};

}  // namespace slamgw::mqttsn
