// SPDX-License-Identifier: Apache-2.0
// MQTT-SN clients on loopback, one UDP socket each, at most one QoS 1 message unacknowledged each.
// Cheaper than slam-gateway-sim's robots, whose cost would distort the daemon's.
#pragma once

#include <deque>
#include <string>
#include <vector>

#include "simulation/thread/packet.hpp"
#include "tests/bench/address.hpp"
#include "tests/bench/sender.hpp"

namespace slamgw::bench {

class Swarm final : public Sender {
 public:
  /// `poller` reports client i as token `first_token` + i. Client ids begin with that of
  /// `first_client`.
  Swarm(const Address& gateway, std::size_t clients, Poller& poller, std::uint64_t first_token,
        std::size_t first_client = 0);
  ~Swarm() override;
  Swarm(const Swarm&) = delete;
  Swarm& operator=(const Swarm&) = delete;

  /// Connects and registers all, `at_once` of them in parallel. Throws when that does not end.
  void connect_all(std::size_t at_once);
  /// Lets the next client, in turn, send a PINGREQ. Each client must within `keep_alive`.
  void ping_next();
  std::uint64_t pings_unanswered() const { return pings_unanswered_; }
  static constexpr std::chrono::seconds keep_alive{60};
  /// Returns the time from CONNECT to CONNACK of each client, in ns.
  std::vector<std::int64_t>& connect_times() { return connect_times_; }

  std::optional<std::size_t> free_client() override;
  void submit(const Message& message, unsigned qos) override;
  std::size_t unfinished() const override { return unfinished_; }
  void on_readable(std::uint64_t token) override;
  void on_tick(Clock::time_point now) override;
  void flush() override {}
  std::uint64_t repeats() const override { return repeats_; }

 private:
  enum class State : std::uint8_t { idle, connecting, registering, ready };
  struct Client {
    int descriptor = -1;
    State state = State::idle;
    bool is_busy = false;
    std::uint16_t topic_id = 0;
    std::uint16_t msg_id = 0;
    Clock::time_point sent_at{};
    sim::Bytes unacknowledged;
    std::deque<Message> waiting;
  };

  void on_packet(Client& client, std::size_t index, const sim::sn::Packet& packet);
  void request(Client& client, sim::Bytes datagram);
  void start_next(Client& client);
  void transmit(const Client& client, sim::ByteView datagram);

  Poller& poller_;
  std::uint64_t first_token_;
  std::size_t first_client_;
  std::vector<Client> clients_;
  std::vector<std::int64_t> connect_times_;
  std::size_t ready_ = 0;
  std::size_t unfinished_ = 0;
  std::size_t busy_ = 0;
  std::size_t next_ = 0;
  std::uint64_t repeats_ = 0;
  std::size_t next_ping_ = 0;
  std::uint64_t pings_unanswered_ = 0;
};

}  // namespace slamgw::bench
