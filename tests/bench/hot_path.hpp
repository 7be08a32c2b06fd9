// SPDX-License-Identifier: Apache-2.0
// The pure code that a message of a Thread robot passes, wired as in App: MQTT-SN machine, core and
// outbox, and a broker that acknowledges everything at once. Counts the allocations of the path. No
// sockets, no threads; a clock of its own.
#pragma once

#include "adapters/mqttsn_udp/sn_gateway.hpp"
#include "daemon/core/gateway.hpp"
#include "daemon/delivery/outbox.hpp"

namespace slamgw::bench {

class HotPath {
 public:
  /// `clients`: number of connected clients, each with its own topic and a subscription to its
  /// commands.
  /// `between`: time from one message to the next.
  HotPath(std::uint16_t clients, Duration between);

  /// Lets one client after the other send an update, up to its PUBACK.
  void publish(Qos qos);
  /// Sends a command at QoS 1 to one client after the other, up to the outcome at the broker.
  void command();
  /// Lets a client send a PINGREQ.
  void ping();

  std::uint64_t sent_datagrams() const { return sent_datagrams_; }
  std::uint64_t at_broker() const { return at_broker_; }
  /// Returns how many sessions and messages were to be written.
  std::uint64_t at_disk() const { return at_disk_; }
  /// Returns the path's calls of operator new since forget_allocations(), without the clients'.
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
  std::optional<mqttsn::Publish> command_;  ///< as received by the client
};

}  // namespace slamgw::bench
