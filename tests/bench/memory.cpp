// SPDX-License-Identifier: Apache-2.0
// Memory after a million connects and disconnects, and after 100 000 topics.
#include <fmt/format.h>
#include <sys/socket.h>
#include <unistd.h>

#include "simulation/thread/packet.hpp"
#include "tests/bench/bounds.hpp"
#include "tests/bench/world.hpp"

namespace slamgw::bench {
namespace {

namespace sn = sim::sn;

/// Clients that send one request at a time and wait for the answer, for at most a second.
class Asker {
 public:
  explicit Asker(const Address& gateway) : descriptor_(open_connected(gateway, SOCK_DGRAM)) {
    const timeval limit{1, 0};
    setsockopt(descriptor_, SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit);
  }
  ~Asker() { close(descriptor_); }
  Asker(const Asker&) = delete;
  Asker& operator=(const Asker&) = delete;

  void ask(const sim::Bytes& question, sn::Type answer) {
    std::array<std::uint8_t, 256> buffer;
    for (int attempt = 0; attempt < 10; ++attempt) {
      (void)::send(descriptor_, question.data(), question.size(), MSG_NOSIGNAL);
      const ssize_t size = recv(descriptor_, buffer.data(), buffer.size(), 0);
      if (size <= 0) continue;
      const auto packet = sn::decode(sim::ByteView(buffer).first(static_cast<std::size_t>(size)));
      if (packet && packet->type == answer) return;
    }
    throw std::runtime_error("the gateway does not answer");
  }

 private:
  int descriptor_;
};

void come_and_go(World& world, std::size_t times) {
  constexpr std::size_t ids = 10000;
  Asker asker(world.sn_address());
  for (std::size_t i = 0; i < times; ++i) {
    asker.ask(sn::connect(robot_id(i % ids), 60, sn::flag_clean_session), sn::Type::connack);
    asker.ask(sn::disconnect(), sn::Type::disconnect);
  }
}

void register_topics(World& world, std::size_t clients, std::size_t each) {
  for (std::size_t client = 0; client < clients; ++client) {
    Asker asker(world.sn_address());
    asker.ask(sn::connect(robot_id(client), 60, sn::flag_clean_session), sn::Type::connack);
    for (std::size_t topic = 0; topic < each; ++topic)
      asker.ask(
          sn::register_topic(static_cast<std::uint16_t>(topic + 1),
                             fmt::format("ntnu-slam/robot/{}/topic-{}", robot_id(client), topic)),
          sn::Type::regack);
    asker.ask(sn::disconnect(), sn::Type::disconnect);
  }
}

double mib_after_rest(World& world) {
  settle(world);
  return static_cast<double>(usage_of(world.pid()).rss_kib) / 1024;
}

}  // namespace

void memory(Report& report) {
  World world;
  come_and_go(world, 100'000);
  const double first = mib_after_rest(world);
  come_and_go(world, 900'000);
  const double last = mib_after_rest(world);
  report.budget_at_most("RSS after 1 000 000 connects and disconnects, of that after 100 000",
                        last / first, 1.1, "times",
                        fmt::format("{:.1f} MiB to {:.1f} MiB", last, first));
  World other;
  register_topics(other, 10, 1000);
  const double few = mib_after_rest(other);
  register_topics(other, 100, 1000);
  const double many = mib_after_rest(other);
  report.budget_at_most("RSS after 100 000 topics, of that after 10 000", many / few, 1.1, "times",
                        fmt::format("{:.1f} MiB to {:.1f} MiB", many, few));
}

}  // namespace slamgw::bench
