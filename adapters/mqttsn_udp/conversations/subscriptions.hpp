// SPDX-License-Identifier: Apache-2.0
// SUBSCRIBE and UNSUBSCRIBE (MQTT-SN 1.2 section 6.9): who has which filter, what the broker is
// asked for, and who still waits for retained messages. Delivery is Downlink's.
#pragma once

#include <string>
#include <string_view>
#include <unordered_set>
#include <vector>

#include "adapters/mqttsn_udp/clients/client_table.hpp"
#include "adapters/mqttsn_udp/conversations/answers.hpp"
#include "adapters/mqttsn_udp/conversations/refusals.hpp"
#include "adapters/mqttsn_udp/conversations/subscribe_requests.hpp"
#include "adapters/mqttsn_udp/name_rules.hpp"
#include "adapters/mqttsn_udp/output.hpp"
#include "daemon/core/topic_tree.hpp"

namespace slamgw::mqttsn {

class Subscriptions {
 public:
  /// One subscription that matches; `subscription` lives in `session`.
  struct Match {
    ClientSession* session = nullptr;
    Subscription* subscription = nullptr;
  };

  /// `broker_up_since`: nothing while the broker is away.
  Subscriptions(const NameRules& rules, const std::optional<TimePoint>& broker_up_since,
                ClientTable& clients, Output& output, Answers& answers, Refusals& refusals)
      : rules_(rules),
        broker_up_since_(broker_up_since),
        clients_(clients),
        output_(output),
        answers_(answers),
        refusals_(refusals),
        requests_(broker_up_since, output) {}

  void on_subscribe(ClientSession& session, const Subscribe& request, TimePoint now);
  void on_unsubscribe(ClientSession& session, const Unsubscribe& request, TimePoint now);
  /// The broker's answer to the open request for `filter`; the sessions that it was for.
  std::vector<ClientSession*> on_subscribe_result(const std::string& filter, bool granted,
                                                  TimePoint now);

  void on_broker_up(TimePoint now);
  void on_broker_down(TimePoint now);
  std::optional<TimePoint> deadline() const { return requests_.deadline(); }
  void on_deadline(TimePoint now) { requests_.on_deadline(now); }
  /// Whether this retained message is one that the subscription still waits for; true once for each
  /// topic (R102).
  bool takes_retained(Subscription& subscription, const std::string& topic, TimePoint now) const;

  /// All subscriptions that match; a session with several such filters comes several times.
  std::vector<Match> match(const std::string& topic) const;
  bool is_wanted(const ClientSession& session, const std::string& topic) const;
  void drop(ClientSession& session, const std::string& filter, TimePoint now);
  void drop_all(ClientSession& session, TimePoint now);
  /// Those that the topic policy does not allow (any more).
  void drop_forbidden(ClientSession& session, TimePoint now);
  /// Asks the broker for the subscriptions of a session that comes back from the store.
  void restore(ClientSession& session, TimePoint now);

  /// The broker is not asked any more for what concerns `robot`: it is a name that the client's
  /// robot gives up or takes over.
  void suspend(ClientSession& session, const std::string& robot, TimePoint now);
  /// It is asked again, after a rename: the subscriptions are new ones of the robot's new name.
  void resume(ClientSession& session, TimePoint now);

  /// The gateway itself hears all commands for the client's robot, so that one of a type that the
  /// client has not subscribed to has its outcome too. From the session's begin to its end.
  void listen_for_commands(const ClientSession& session, TimePoint now);
  void stop_listening(const ClientSession& session, TimePoint now);

 private:
  struct Wish {
    std::string filter;
    std::uint16_t topic_id = 0;
  };
  /// What the client means by the request, or why it can't have it.
  Result<Wish, ReturnCode> read(ClientSession& session, const Subscribe& request, TimePoint now);
  const std::string* name(ClientSession& session, TopicIdType type, std::uint16_t topic_id,
                          const std::string& topic_name, std::string& storage) const;
  void refuse(ClientSession& session, const Subscribe& request, ReturnCode code);
  bool is_repetition(const ClientSession& session, const Subscribe& request,
                     const std::string& filter, TimePoint now) const;
  void ask_broker(ClientSession& session, const std::string& filter, Qos qos, Suback answer,
                  TimePoint now);
  void drop_everywhere(const std::string& filter, TimePoint now);
  bool begin_wait(Subscription& subscription) const;
  void add_subscriber(const std::string& filter, ClientSession& session,
                      Subscription& subscription);
  void remove_subscriber(const std::string& filter, ClientSession& session);
  /// The broker's answer, as far as it concerns `listen_for_commands`.
  void note_listening(const std::string& filter, bool granted);
  std::vector<std::string> filters_of(const ClientSession& session, const std::string& robot) const;
  /// Unsubscribes at the broker when no client has the filter any more.
  void unsubscribe_unwanted(const std::string& filter, TimePoint now);
  void notice_given_up(const ClientSession& session, std::vector<std::string> filters,
                       std::string_view why, TimePoint now);
  void notice_refusal(const ClientSession& session, const std::string& filter, TimePoint now);

  const NameRules& rules_;
  const std::optional<TimePoint>& broker_up_since_;
  ClientTable& clients_;
  Output& output_;
  Answers& answers_;
  Refusals& refusals_;
  TopicTree<std::vector<Match>> subscribers_;
  SubscribeRequests requests_;
  std::unordered_set<std::string> listening_;  // filters of `listen_for_commands`
  /// Those of them that the broker refused: it is asked again when it comes back.
  std::unordered_set<std::string> refused_listening_;
};

}  // namespace slamgw::mqttsn
