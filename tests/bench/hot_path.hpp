// SPDX-License-Identifier: Apache-2.0
// The pure code that a message of a Thread robot passes, wired as App wires it: MQTT-SN machine,
// core and outbox, and a broker that takes everything at once. Counts what the path allocates. No
// sockets, no threads; a clock of its own.
#pragma once

#include "adapters/mqttsn_udp/sn_gateway.hpp"
#include "daemon/core/gateway.hpp"
#include "daemon/delivery/outbox.hpp"

namespace slamgw::bench {

class HotPath {
 public:
  /// `clients` connected ones, each with a topic of its own and a subscription to its commands.
  /// `between`: time from one message to the next.
  HotPath(std::uint16_t clients, Duration between);

  /// One client after the other sends an update, up to its PUBACK.
  void publish(Qos qos);
  /// One client after the other is sent a command at QoS 1 and acknowledges it, up to the outcome
  /// at the broker.
  void command();
  /// A client that has nothing to say.
  void ping();

  std::uint64_t sent_datagrams() const { return sent_datagrams_; }
  std::uint64_t at_broker() const { return at_broker_; }
  /// Sessions and messages that were to be written.
  std::uint64_t at_disk() const { return at_disk_; }
  /// Calls of operator new of the path since forget_allocations(), without the clients' own.
  std::uint64_t allocations() const { return allocations_; }
  void forget_allocations() { allocations_ = 0; }

 private:
  std::uint16_t next_client();
  void on_datagram(std::uint16_t client, const mqttsn::Packet& packet);
  void on_robot_message(const std::string& robot, std::string_view payload);
  void drain();
  template <class Action>
  void perform(Action& action) {
    std::visit([this](auto& what) { handle(what); }, action);
  }
  template <class Other>
  void handle(Other&) {}
  void handle(mqttsn::SendDatagram& datagram);
  void handle(MeshEvent& event);
  void handle(PassUp& up);
  void handle(Upload& upload);
  void handle(DeliverToMesh& delivery);
  void handle(PublishAtBroker& publish);
  void handle(FireReceipt& fired);
  void handle(WriteToStore&) { ++at_disk_; }
  void handle(RetryDeadLetters&) {}

  const std::uint16_t clients_;
  const Duration between_;
  Now now_;
  const BrokerLink link_{true, {}, {}};
  mqttsn::SnGateway mesh_;
  Gateway core_;
  Outbox outbox_;
  std::uint64_t turn_ = 0;
  std::uint64_t sent_datagrams_ = 0;
  std::uint64_t at_broker_ = 0;
  std::uint64_t at_disk_ = 0;
  std::uint64_t allocations_ = 0;
  std::vector<std::uint16_t> update_ids_;   ///< of each client
  std::optional<mqttsn::Publish> command_;  ///< as the client has got it
};

}  // namespace slamgw::bench
