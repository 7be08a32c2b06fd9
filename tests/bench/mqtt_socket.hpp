// SPDX-License-Identifier: Apache-2.0
// A minimal MQTT 3.1.1 client: one connection, QoS 0 and 1, no keep-alive, no reconnecting. The
// daemon is compared with it, and it is the subscriber of every run.
#pragma once

#include <cstdint>
#include <functional>
#include <string_view>

#include "tests/bench/address.hpp"
#include "tests/bench/message.hpp"

namespace slamgw::bench {

class MqttSocket {
 public:
  /// Connects and waits for the CONNACK. Throws std::runtime_error.
  MqttSocket(const Address& broker, std::string_view client_id);
  ~MqttSocket();
  MqttSocket(const MqttSocket&) = delete;
  MqttSocket& operator=(const MqttSocket&) = delete;

  int descriptor() const { return descriptor_; }
  /// Waits for the SUBACK. Throws std::runtime_error.
  void subscribe(std::string_view filter, unsigned qos);
  /// `id` is 0 at QoS 0. Goes out with flush().
  void publish(std::string_view topic, ByteView payload, unsigned qos, std::uint16_t id);
  void flush();
  /// Reads the pending octets, once. Acknowledges each PUBLISH.
  void on_readable();

  std::function<void(ByteView payload)> on_message;
  std::function<void(std::uint16_t id)> on_puback;

 private:
  void await(std::uint8_t type);
  std::uint8_t parse_packets();
  void on_packet(std::uint8_t first, ByteView body);
  void add_packet(std::uint8_t first, const Bytes& body);

  int descriptor_;
  Bytes in_;
  Bytes out_;
};

}  // namespace slamgw::bench
