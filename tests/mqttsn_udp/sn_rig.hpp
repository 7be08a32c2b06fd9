// SPDX-License-Identifier: Apache-2.0
// The gateway's machine on a virtual clock with clients that are only addresses. Sends octets or
// packets, collects the output as text, and acts as the robots' sessions at the broker.
#pragma once

#include <deque>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/sn_gateway.hpp"
#include "tests/mqttsn_udp/describe.hpp"

namespace slamgw::mqttsn {

/// A topic that client r1 may publish.
inline const std::string own_topic = "ntnu-slam/robot/r1/adv";
/// The topic of client r1's commands.
inline const std::string r1_command = "ntnu-slam/server/r1/cmd";

class SnRig {
 public:
  explicit SnRig(Settings settings = {}, std::vector<RobotName> names = {},
                 std::vector<std::string> extra_publish = {"w/#", "a/#", "ab"},
                 std::vector<std::string> extra_subscribe = {"w/#", "a/#", "ab"},
                 RandomSource random = {});

  /// Clients from this number on have IPv4 addresses.
  static constexpr unsigned first_ipv4 = 0x1000;
  /// Returns the address of client number `n`, without the node id of a forwarder.
  static Endpoint address(unsigned n);
  static LocalAddress local();

  // Verbs of clients. All take the number of the address they come from.
  void send(unsigned n, const Packet& packet);
  void send_octets(unsigned n, ByteView octets);
  void connect(unsigned n, const std::string& id, bool clean = true, std::uint16_t duration_s = 60);
  std::uint16_t register_topic(unsigned n, const std::string& topic);
  void subscribe(unsigned n, const std::string& filter, unsigned qos = 1);
  /// Connects client `n` as `id` and acknowledges a message, so it has shown that it receives.
  void prove(unsigned n, const std::string& id, std::uint16_t duration_s = 60);
  void sleep(unsigned n, std::uint16_t duration_s = 100);
  void publish(unsigned n, std::uint16_t id, unsigned qos, std::uint16_t msg_id,
               const std::string& payload = "hi");

  // Verbs of the core.
  /// Sends a message to each robot that has subscribed to it. A command without a subscription is
  /// delivered as unasked, unless it is retained.
  void broker(const std::string& topic, const std::string& payload = "hi", unsigned qos = 0,
              bool retain = false);
  void robot_message(RobotMessage message);
  void receipt(std::uint64_t id, ReceiptOutcome outcome = ReceiptOutcome::safe);
  /// Answers all robots that wait for this SUBSCRIBE at the broker.
  void subscribe_result(const std::string& filter, bool granted);
  /// Nothing: the note cannot be read yet.
  void note(const std::string& robot, std::optional<ByteView> note);
  void session_held(const std::string& robot);
  std::vector<WaitingMessage> give_up(const std::string& robot);
  void broker_link(bool is_up);
  void ping(std::uint64_t id, const std::string& robot);
  void stop();
  /// Reloads the configuration with these `robots`.
  void rename(std::vector<RobotName> names);
  /// Reloads the robots' keys.
  void use_keys(Identities of);

  /// Lets time pass, firing each deadline on its way.
  void pass(Duration time);
  void pass_s(int seconds) { pass(std::chrono::seconds(seconds)); }

  /// Returns the messages to client `n` since the last call, as text.
  std::vector<std::string> sent_to(unsigned n);
  bool is_silent(unsigned n) { return sent_to(n).empty(); }
  std::string last_to(unsigned n);
  std::vector<std::string> multicasts;
  std::vector<SendDatagram> datagrams;  ///< all that were sent
  std::vector<Report> reports;
  std::vector<PresenceChange> presence;
  std::vector<SubscribeRequest> subscribes;
  std::vector<UnsubscribeRequest> unsubscribes;
  std::vector<SessionCleaned> cleaned;
  std::vector<SessionEvicted> evicted;
  std::vector<NoteChanged> notes;
  std::vector<NoteRequest> note_requests;
  std::vector<PingEnded> pings;
  /// The filters of each robot's session at the broker.
  std::map<std::string, std::set<std::string>> filters;
  std::vector<CommandOutcome> outcomes;
  std::vector<MessageStep> steps;
  std::vector<Notice> notices;
  unsigned signs_of_life = 0;

  std::uint64_t counter(std::string_view name) const;

  const TopicPolicy policy;
  SnGateway gateway;
  TimePoint now{std::chrono::hours(1)};
  /// If true, the core grants each SubscribeRequest at once.
  bool answers_subscribes = true;
  /// If false, clients must show by an answer that they receive.
  bool are_addresses_validated = true;
  /// By client: the identity that its DTLS key proves. All other clients use plain UDP.
  std::map<unsigned, std::string> proven;

 private:
  void drain();
  void take(SendDatagram& action);
  void take(MeshEvent& event);

  std::map<Endpoint, std::vector<std::string>> outbox_;
  std::deque<SubscribeRequest> to_answer_;
  Identities identities_;
  std::uint16_t msg_id_ = 1000;
  std::uint64_t last_command_ = 0;
};

/// Client r1 is connected from address 1.
struct ConnectedRig : SnRig {
  explicit ConnectedRig(bool clean = true, std::uint16_t duration_s = 60) {
    connect(1, "r1", clean, duration_s);
  }
  explicit ConnectedRig(Settings settings) : SnRig(std::move(settings)) { connect(1, "r1"); }
};

/// Joins lists, for comparisons.
using Lines = std::vector<std::string>;

}  // namespace slamgw::mqttsn
