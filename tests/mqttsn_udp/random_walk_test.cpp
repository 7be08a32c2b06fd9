// SPDX-License-Identifier: Apache-2.0
// Several clients and the gateway on one virtual clock, joined by a network that loses, doubles,
// delays and reorders datagrams. The promises of delivery must hold.
#include <gtest/gtest.h>

#include "tests/mqttsn_udp/sn_rig.hpp"
#include "tests/mqttsn_udp/walk_client.hpp"

namespace slamgw::mqttsn {
namespace {

using std::chrono::milliseconds;

struct Weather {
  double loss = 0;
  double duplicate = 0;
  int max_delay_ms = 0;  // differs for each datagram, so they overtake each other
};

class Walk {
 public:
  Walk(std::uint64_t seed, Weather weather) : random_(seed), weather_(weather) {
    rig_.are_addresses_validated = false;
    for (unsigned n = 0; n < 4; ++n) clients_.emplace_back("c" + std::to_string(n), 12, seed + n);
  }

  void run() {
    for (int step = 0; step < 40000 && !is_done(); ++step) {
      if (step == 6000) {
        for (WalkClient& client : clients_) client.stay_awake();
      }
      one_step(step);
    }
    EXPECT_TRUE(is_done()) << "a client is stuck";
  }

  void check() {
    std::map<std::string, unsigned> up;
    for (const Report& report : rig_.reports) ++up[std::string(as_text(report.payload))];
    for (const WalkClient& client : clients_) {
      for (const auto& message : client.published()) {
        const unsigned times = up[message.payload];
        EXPECT_LE(times, 1U) << message.payload << " went up more than once";
        if (message.is_acknowledged) {
          EXPECT_EQ(times, 1U) << message.payload << " was lost";
        }
      }
      check_down(client);
    }
  }

 private:
  struct Flying {
    unsigned n;
    bool is_up;
    Bytes octets;
  };

  void one_step(int step) {
    rig_.pass(milliseconds(50));
    collect();
    fire_receipts();
    while (!flying_.empty() && flying_.begin()->first <= rig_.now) {
      const Flying arrival = flying_.begin()->second;
      flying_.erase(flying_.begin());
      arrive(arrival);
    }
    for (unsigned n = 0; n < clients_.size(); ++n) {
      for (const Packet& packet : clients_[n].on_tick(rig_.now)) launch({n, true, encode(packet)});
    }
    if (step % 100 == 99 && sent_down_ < 40) send_down();
  }

  void arrive(const Flying& arrival) {
    if (!arrival.is_up) {
      for (const Packet& answer : clients_[arrival.n].on_packet(*decode(arrival.octets), rig_.now))
        launch({arrival.n, true, encode(answer)});
      return;
    }
    const auto before = rig_.gateway.snapshot(clients_[arrival.n].id(), rig_.now);
    const bool sleeps =
        before && before->state == ClientState::asleep;  // or awake until the PINGRESP
    const Packet packet = *decode(arrival.octets);
    if (std::holds_alternative<Pingreq>(packet) || std::holds_alternative<Connect>(packet))
      listens_[arrival.n] = true;
    rig_.send_octets(arrival.n, arrival.octets);
    collect(sleeps && !listens_[arrival.n] ? static_cast<int>(arrival.n) : -1);
  }

  /// Sends the gateway's datagrams over the network. None may go to `sleeper` unasked (R116).
  void collect(int sleeper = -1) {
    for (const SendDatagram& sent : rig_.datagrams) {
      const unsigned n = sent.to.address[15];
      const Packet packet = *decode(sent.bytes);
      if (static_cast<int>(n) == sleeper) {
        EXPECT_FALSE(std::holds_alternative<Publish>(packet) ||
                     std::holds_alternative<Register>(packet))
            << describe(packet) << " to a sleeping client";
      }
      if (std::holds_alternative<Pingresp>(packet)) listens_[n] = false;
      launch({n, false, sent.bytes});
    }
    rig_.datagrams.clear();
  }

  void launch(const Flying& datagram) {
    const auto chance = [&](double p) {
      return std::uniform_real_distribution<double>(0, 1)(random_) < p;
    };
    const int copies = chance(weather_.loss) ? 0 : chance(weather_.duplicate) ? 2 : 1;
    for (int i = 0; i < copies; ++i) {
      const int delay = std::uniform_int_distribution<int>(0, weather_.max_delay_ms)(random_);
      flying_.emplace(rig_.now + milliseconds(delay), datagram);
    }
  }

  void fire_receipts() {
    for (; fired_ < rig_.reports.size(); ++fired_) {
      if (rig_.reports[fired_].receipt.is_owed()) rig_.receipt(rig_.reports[fired_].receipt.id);
    }
    collect();
  }

  void send_down() {
    const unsigned qos = 1 + static_cast<unsigned>(random_() % 2);
    for (const WalkClient& client : clients_)
      rig_.broker(client.down_topic(), std::to_string(qos) + ":" + std::to_string(sent_down_), qos);
    ++sent_down_;
  }

  bool is_done() const {
    if (sent_down_ < 40) return false;
    for (const WalkClient& client : clients_) {
      if (!client.is_done() || rig_.gateway.queued_for(client.id()) != 0) return false;
    }
    return true;
  }

  /// Checks for order and QoS 2 exactly once, from the first message after the subscription.
  void check_down(const WalkClient& client) {
    int last = -1;
    for (const std::string& payload : client.taken()) {
      const int number = std::stoi(payload.substr(2));
      EXPECT_GT(number, last) << client.id() << " got them out of order";
      EXPECT_TRUE(last == -1 || number == last + 1) << client.id() << " misses one";
      last = number;
      if (payload[0] == '2') {
        EXPECT_EQ(client.times_taken().at(payload), 1U) << payload;
      }
    }
    EXPECT_EQ(last, 39) << client.id();
  }

  SnRig rig_;
  std::mt19937_64 random_;
  Weather weather_;
  std::vector<WalkClient> clients_;
  std::map<unsigned, bool> listens_;  // from its PINGREQ to the PINGRESP
  std::multimap<TimePoint, Flying> flying_;
  std::size_t fired_ = 0;
  int sent_down_ = 0;
};

void walk(Weather weather, std::uint64_t seeds) {
  for (std::uint64_t seed = 1; seed <= seeds; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Walk walk(seed, weather);
    walk.run();
    walk.check();
    if (testing::Test::HasFailure()) return;
  }
}

TEST(RandomWalk, KeepsEveryPromiseOnAPerfectNetwork) { walk({}, 1); }
TEST(RandomWalk, KeepsEveryPromiseUnderLoss) { walk({0.2, 0, 0}, 2); }
TEST(RandomWalk, KeepsEveryPromiseUnderDuplication) { walk({0, 0.3, 0}, 2); }
TEST(RandomWalk, KeepsEveryPromiseUnderReordering) { walk({0, 0, 400}, 2); }
TEST(RandomWalk, KeepsEveryPromiseUnderEverythingAtOnce) { walk({0.15, 0.15, 400}, 3); }

}  // namespace
}  // namespace slamgw::mqttsn
