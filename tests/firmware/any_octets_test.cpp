// SPDX-License-Identifier: Apache-2.0
// Random octets for both headers, the same in each run: no crash and no broken invariant.
#include "tests/firmware/any_octets.hpp"

#include <gtest/gtest.h>

#include <random>

#include "tests/mqttsn_udp/describe.hpp"
#include "tests/vectors/mqttsn_vectors.hpp"

namespace slamgw::firmware {
namespace {

/// Adds test vectors, one octet of which may be changed.
void add_vector(Bytes& script, std::mt19937& random) {
  const auto& vectors = mqttsn::message_vectors;
  Bytes octets = mqttsn::hex(vectors[random() % vectors.size()].wire);
  if (random() % 3 == 0) octets[random() % octets.size()] = static_cast<std::uint8_t>(random());
  script.insert(script.end(), {0, 0, static_cast<std::uint8_t>(octets.size() - 1)});
  script.insert(script.end(), octets.begin() + 1, octets.end());
}

/// Adds an acceptance of a request that is likely to be open: message ids go up from 0xfff0.
void add_acceptance(Bytes& script, std::mt19937& random) {
  const auto id = static_cast<std::uint8_t>(0xf0 + random() % 8);
  const auto topic = static_cast<std::uint8_t>(random() % 4);
  switch (random() % 5) {
    case 0: script.insert(script.end(), {0, 0, 2, 0x05, 0}); return;
    case 1: script.insert(script.end(), {0, 0, 6, 0x0b, 0, topic, 0xff, id, 0}); return;
    case 2: script.insert(script.end(), {0, 0, 7, 0x13, 0, 0, topic, 0xff, id, 0}); return;
    case 3: script.insert(script.end(), {0, 0, 6, 0x0d, 0, topic, 0xff, id, topic}); return;
    default: script.insert(script.end(), {0, 0, 3, 0x0f, 0xff, id}); return;
  }
}

TEST(FirmwareHeaders, KeepTheirInvariantsForRandomInput) {
  std::mt19937 random(3);
  const auto octet = [&] { return static_cast<std::uint8_t>(random()); };
  for (int life = 0; life < 150; ++life) {
    Bytes script;
    for (int i = 0; i < 200; ++i) {
      const auto choice = random() % 8;
      if (choice < 3) {
        add_acceptance(script, random);
      } else if (choice < 6) {
        add_vector(script, random);
      } else {
        const auto size = static_cast<std::uint8_t>(random() % 20);
        script.insert(script.end(), {octet(), octet(), size});
        for (int j = 0; j < size; ++j) script.push_back(octet());
      }
    }
    SnLife one;
    ASSERT_TRUE(one.run(script)) << to_hex(script);
  }
}

TEST(FirmwareHeaders, ReadAnyAccessMessage) {
  std::mt19937 random(4);
  for (int i = 0; i < 10000; ++i) {
    Bytes octets(random() % 260);
    for (std::uint8_t& octet : octets) octet = static_cast<std::uint8_t>(random());
    if (octets.size() > 3 && random() % 4 > 0) {
      octets[0] = static_cast<std::uint8_t>(0xc4 + random() % 17);
      octets[1] = 0x59;
      octets[2] = 0;
      octets.resize(3 + random() % (octets.size() - 2));
    }
    ASSERT_TRUE(ble_holds(octets)) << to_hex(octets);
  }
}

}  // namespace
}  // namespace slamgw::firmware
