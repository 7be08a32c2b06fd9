// SPDX-License-Identifier: Apache-2.0
// Random bytes into every machine of the simulator: no crash, and bounded memory.
#include <gtest/gtest.h>

#include <algorithm>

#include "simulation/ble/network.hpp"
#include "simulation/thread/client.hpp"

namespace slamgw::sim {
namespace {

using std::chrono::milliseconds;

Bytes noise(Random& random, std::uint32_t limit) {
  Bytes out(random.below(limit));
  for (std::uint8_t& octet : out) octet = static_cast<std::uint8_t>(random.below(256));
  return out;
}

TEST(Client, SurvivesRandomDatagrams) {
  Random random(5, 0, Random::Use::radio);
  TimePoint now{std::chrono::seconds{1}};
  for (int round = 0; round < 20; ++round) {
    sn::ClientSettings settings;
    settings.client_id = "robot1";
    sn::Client client(settings, RobotBody(1, 1));
    client.on_start(now);
    for (int i = 0; i < 2000; ++i) {
      now += milliseconds{50};
      Bytes datagram = noise(random, 12);
      if (datagram.size() >= 2) {
        datagram[0] = static_cast<std::uint8_t>(datagram.size());
        datagram[1] &= 0x1f;
        if (datagram.size() > 6) datagram[4] = datagram[5] = 0;
      }
      client.on_datagram(datagram, now);
      if (client.deadline() && *client.deadline() <= now) client.on_deadline(now);
      int answers = 0;
      while (client.next_datagram()) ++answers;
      ASSERT_LE(answers, 40);
    }
  }
}

TEST(Network, SurvivesRandomProvisioningCommands) {
  Random random(7, 0, Random::Use::radio);
  TimePoint now{std::chrono::seconds{1}};
  BleOptions options;
  options.is_unprovisioned = true;
  options.is_configured = true;
  options.net_key = Bytes(16, 1);
  options.app_key = Bytes(16, 2);
  for (int round = 0; round < 5; ++round) {
    ble::Network network(options);
    network.on_start(now);
    Bytes uuid(16);
    for (int i = 0; i < 1000; ++i) {
      now += milliseconds{50};
      Bytes packet = noise(random, 60);
      packet.resize(packet.size() + 20);
      packet[0] = static_cast<std::uint8_t>(packet.size() - 1);
      packet[1] = static_cast<std::uint8_t>(0x61 + random.below(10));
      packet[2] &= 1;
      if (packet[1] == 0x66) packet[3] = packet[5] = 0;
      if (packet[1] == 0x63) std::copy(uuid.begin(), uuid.end(), packet.begin() + 3);
      network.on_host_bytes(packet, now);
      for (int events = 0; network.deadline() <= now && events < 100; ++events) {
        network.on_deadline(now);
      }
      std::size_t octets = 0;
      while (auto to_host = network.next_host_packet(now)) {
        octets += to_host->size();
        if ((*to_host)[1] == 0xc0) std::copy_n(to_host->begin() + 2, 16, uuid.begin());
      }
      ASSERT_LE(octets, ble::TransmitBuffer::capacity);
    }
  }
}

TEST(Network, SurvivesRandomBytesFromTheHost) {
  Random random(6, 0, Random::Use::radio);
  TimePoint now{std::chrono::seconds{1}};
  BleOptions options;
  options.is_configured = true;
  options.net_key = Bytes(16, 1);
  options.app_key = Bytes(16, 2);
  for (int round = 0; round < 20; ++round) {
    ble::Network network(options);
    network.on_start(now);
    for (int i = 0; i < 2000; ++i) {
      now += milliseconds{20};
      Bytes packet = noise(random, 24);
      if (packet.size() >= 2) packet[0] = static_cast<std::uint8_t>(packet.size() - 1);
      if (packet.size() >= 2 && random.chance(0.7))
        packet[1] = static_cast<std::uint8_t>(packet[1] % 32 + 0x90);
      network.on_host_bytes(packet, now);
      for (int events = 0; network.deadline() <= now && events < 100; ++events) {
        network.on_deadline(now);
      }
      std::size_t octets = 0;
      while (auto to_host = network.next_host_packet(now)) octets += to_host->size();
      ASSERT_LE(octets, ble::TransmitBuffer::capacity);
    }
  }
}

}  // namespace
}  // namespace slamgw::sim
