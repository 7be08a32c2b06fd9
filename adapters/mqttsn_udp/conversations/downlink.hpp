// SPDX-License-Identifier: Apache-2.0
// Messages on their way to one client: the queue, PUBLISH, its acknowledgement and repetition
// (MQTT-SN 1.2 sections 6.6, 6.10, 6.13). One PUBLISH of QoS 1 or 2 at a time for each client, each
// client by itself (R91, R147); messages of one topic keep their order. What the client does not
// answer holds nothing else back for longer than one wait: see TopicRegistration and Release.
#pragma once

#include <deque>
#include <memory>
#include <string>

#include "adapters/mqttsn_udp/clients/delivery.hpp"
#include "adapters/mqttsn_udp/conversations/retransmission.hpp"
#include "adapters/mqttsn_udp/conversations/subscriptions.hpp"
#include "adapters/mqttsn_udp/conversations/topic_registration.hpp"
#include "daemon/core/log_throttle.hpp"

namespace slamgw::mqttsn {

/// Tells the outcome of each command exactly once: when the robot has it, when it can't get it, or
/// when 30 s are over. Knows nothing of the delivery, which the gateway withdraws then.
class CommandWatch : Conversation {
 public:
  explicit CommandWatch(const Conversation& common) : Conversation(common) {}

  /// A command that no client can carry out. Nothing happens when `id` is none.
  void refuse(const BrokerMessage& message, CommandId id, std::string why);
  /// Null when `message` is no command for this client's robot.
  std::shared_ptr<Command> begin(const ClientSession& session, const BrokerMessage& message,
                                 CommandId id, TimePoint now);
  /// From before a restart of the daemon: its outcome is still owed.
  void adopt(const std::shared_ptr<Command>& command);
  /// `command` may be null.
  void end(const std::shared_ptr<Command>& command, CommandResult result, std::string why,
           TimePoint now);

  std::optional<TimePoint> deadline() const;
  /// A command whose time is over; `end()` reports its outcome. Null when there is none.
  std::shared_ptr<Command> pop_overdue(TimePoint now);

 private:
  std::deque<std::shared_ptr<Command>> open_;  // in the order they came, so in that of their ends
};

class Downlink : Conversation {
 public:
  Downlink(const Conversation& common, Subscriptions& subscriptions, CommandWatch& commands,
           RandomSource random)
      : Conversation(common),
        subscriptions_(subscriptions),
        commands_(commands),
        registration_(common),
        release_(common),
        random_(std::move(random)) {}

  /// Takes the message, or says why not. `pump()` sends it.
  void on_broker_message(ClientSession& session, const RobotMessage& incoming, TimePoint now);
  /// Sends what may be sent now.
  void pump(ClientSession& session, TimePoint now);

  void on_regack(ClientSession& session, const Regack& regack, TimePoint now);
  void on_puback(ClientSession& session, const Puback& puback, TimePoint now);
  void on_pubrec(ClientSession& session, const Pubrec& pubrec, TimePoint now);
  void on_pubcomp(ClientSession& session, const Pubcomp& pubcomp, TimePoint now);

  /// The client has another address. Unless that has shown that it receives, its first answer to a
  /// new request will.
  void on_address(ClientSession& session);
  /// A PINGREQ that names the client: half a proof that its owner is at this address. Whoever knows
  /// the id can forge it, so it buys no octets; QoS 0 no longer waits for an unanswered REGISTER.
  static void on_named_ping(ClientSession& session) { session.delivery.is_half_proven = true; }
  /// A sign of life: what rested for want of an answer goes on at the next pump (R133).
  void on_heard(ClientSession& session);
  /// The client begins a new connection within its session: it may have forgotten everything.
  void on_reconnect(ClientSession& session);
  /// From now on nothing is sent; what awaits an answer is kept (R116).
  void rest(ClientSession& session);
  /// Whether an answer is awaited, so that an awake client must go on listening.
  bool is_awaiting(const ClientSession& session) const;

  void drop_all(ClientSession& session, const std::string& why, TimePoint now);
  /// QoS 0 does not outlive the connection.
  void drop_volatile(ClientSession& session, const std::string& why, TimePoint now);
  /// The client has no longer this filter: what only it asked for goes (R104).
  void drop_unwanted(ClientSession& session, const std::string& filter, TimePoint now);
  /// Another gateway serves the robot now. Returns what was never on the air; other commands end as
  /// `timeout`, and nothing is left.
  std::vector<WaitingMessage> take_unsent(ClientSession& session, TimePoint now);
  /// The command's time is over: it is not sent (again). Why it has not arrived.
  std::string withdraw(ClientSession& session, const Command& command);

  /// The daemon ends: from now on refuse_unkept() follows each message.
  void on_stop() { is_stopping_ = true; }
  /// What could not be sent and no snapshot keeps (QoS 0) is refused; nothing is sent any more.
  void refuse_unkept(ClientSession& session, TimePoint now);

  std::optional<TimePoint> next_time(const ClientSession& session) const;
  /// Repeats what is due. True when a request was given up and the client said nothing meanwhile.
  bool on_time(ClientSession& session, TimePoint now);

 private:
  void enqueue(ClientSession& session, Outgoing outgoing, TimePoint now);
  bool may_send(const ClientSession& session) const;
  bool is_within_allowance(const ClientSession& session, const Outgoing& outgoing) const;
  void learn_from_answer(ClientSession& session, std::uint16_t msg_id, TimePoint now);
  void on_answer(ClientSession& session, std::uint16_t msg_id);
  bool send_next(ClientSession& session, TimePoint now);
  void resume_withheld(ClientSession& session, TimePoint now);
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
  CommandWatch& commands_;
  TopicRegistration registration_;
  Release release_;
  RandomSource random_;
  bool is_stopping_ = false;
  LogThrottle too_large_;
};

}  // namespace slamgw::mqttsn
