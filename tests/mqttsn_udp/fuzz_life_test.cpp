// SPDX-License-Identifier: Apache-2.0
// R10: random input to gateways that begin with clients in every state.
#include "tests/mqttsn_udp/fuzz_life.hpp"

#include <gtest/gtest.h>

#include <random>

namespace slamgw::mqttsn {
namespace {

void add_datagram(Bytes& script, std::uint8_t from, const Packet& packet) {
  const Bytes octets = encode(packet);  // FuzzLife adds its Length again
  script.insert(script.end(), {6, from, static_cast<std::uint8_t>(octets.size() - 1)});
  script.insert(script.end(), octets.begin() + 1, octets.end());
}

TEST(SnGateway, R10_KeepsItsInvariantsForRandomInput) {
  std::mt19937 random(10);
  const auto octet = [&] { return static_cast<std::uint8_t>(random()); };
  for (int life = 0; life < 60; ++life) {
    Bytes script;
    add_datagram(script, 0, Connect{false, life % 2 == 0, 1, 60, "c"});
    add_datagram(script, 0, Subscribe{false, WireQos::two, TopicIdType::normal, 1, "#", 0});
    script.insert(script.end(), {3, 1});
    if (life % 3 == 0) add_datagram(script, 0, Disconnect{30});
    for (int i = 0; i < 150; ++i) {
      script.insert(script.end(), {octet(), octet()});
      const std::uint8_t size = octet() % 12;
      script.push_back(size);
      for (int j = 0; j < size; ++j)
        script.push_back(static_cast<std::uint8_t>(random() % 2 ? octet() % 32 : octet()));
    }
    FuzzLife one;
    ASSERT_TRUE(one.run(script)) << to_hex(script);
  }
}

}  // namespace
}  // namespace slamgw::mqttsn
