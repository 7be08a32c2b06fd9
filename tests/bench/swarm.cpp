// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/swarm.hpp"

#include <sys/socket.h>
#include <unistd.h>

#include <stdexcept>

namespace slamgw::bench {
namespace {

namespace sn = sim::sn;

/// Shorter than MQTT-SN's 10-15 s (section 7.2), so that a lost datagram costs a run little.
constexpr std::chrono::seconds retry_interval{1};
constexpr std::chrono::seconds connect_limit{60};
}  // namespace

Swarm::Swarm(const Address& gateway, std::size_t clients, Poller& poller, std::uint64_t first_token,
             std::size_t first_client)
    : poller_(poller), first_token_(first_token), first_client_(first_client), clients_(clients) {
  for (std::size_t i = 0; i < clients; ++i) {
    clients_[i].descriptor = open_connected(gateway, SOCK_DGRAM, SOCK_NONBLOCK);
    poller_.add(clients_[i].descriptor, first_token_ + i);
  }
}

Swarm::~Swarm() {
  for (const Client& client : clients_) {
    transmit(client, sn::disconnect());
    close(client.descriptor);
  }
}

void Swarm::connect_all(std::size_t at_once) {
  const auto end = Clock::now() + connect_limit;
  std::size_t started = 0;
  while (ready_ < clients_.size()) {
    const auto now = Clock::now();
    if (now > end) throw std::runtime_error("the gateway does not take all clients");
    for (; started < clients_.size() && started - ready_ < at_once; ++started) {
      clients_[started].state = State::connecting;
      request(clients_[started],
              sn::connect(robot_id(first_client_ + started),
                          static_cast<std::uint16_t>(keep_alive.count()), sn::flag_clean_session));
    }
    poller_.wait(now + std::chrono::milliseconds(50), [this](std::uint64_t token) {
      if (token >= first_token_) on_readable(token);
    });
    on_tick(now);
  }
  repeats_ = 0;
}

void Swarm::ping_next() {
  const Client& client = clients_[next_ping_];
  next_ping_ = (next_ping_ + 1) % clients_.size();
  ++pings_unanswered_;
  transmit(client, sn::pingreq({}));
}

std::optional<std::size_t> Swarm::free_client() {
  if (busy_ == clients_.size()) return std::nullopt;
  do next_ = (next_ + 1) % clients_.size();
  while (clients_[next_].is_busy);
  return next_;
}

void Swarm::submit(const Message& message, unsigned qos) {
  Client& client = clients_[message.client];
  if (qos == 0) {
    transmit(client, sn::publish(0, client.topic_id, 0, to_payload(message)));
    return;
  }
  ++unfinished_;
  client.waiting.push_back(message);
  if (!client.is_busy) start_next(client);
}

void Swarm::on_readable(std::uint64_t token) {
  const std::size_t index = token - first_token_;
  Client& client = clients_[index];
  std::array<std::uint8_t, 256> buffer;
  const ssize_t count = recv(client.descriptor, buffer.data(), buffer.size(), 0);
  if (count <= 0) return;
  const auto packet = sn::decode(sim::ByteView(buffer).first(static_cast<std::size_t>(count)));
  if (packet) on_packet(client, index, *packet);
}

void Swarm::on_packet(Client& client, std::size_t index, const sn::Packet& packet) {
  const bool is_refused = packet.return_code != sn::accepted;
  if (packet.type == sn::Type::connack && client.state == State::connecting) {
    connect_times_.push_back(to_ns(Clock::now()) - to_ns(client.sent_at));
    client.state = State::registering;
    request(client, sn::register_topic(++client.msg_id, topic_of(first_client_ + index)));
  } else if (packet.type == sn::Type::regack && client.state == State::registering && !is_refused) {
    client.topic_id = packet.topic_id;
    client.state = State::ready;
    client.unacknowledged.clear();
    ++ready_;
  } else if (packet.type == sn::Type::puback && client.is_busy && packet.msg_id == client.msg_id &&
             !is_refused) {
    client.is_busy = false;
    client.unacknowledged.clear();
    --busy_;
    --unfinished_;
    if (!client.waiting.empty()) start_next(client);
  } else if (packet.type == sn::Type::pingresp) {
    --pings_unanswered_;
  } else if (packet.type == sn::Type::disconnect &&
             (client.state == State::registering || client.state == State::ready)) {
    // Before the CONNACK the packet is for a client that had this port before.
    throw std::runtime_error("the gateway has disconnected " + robot_id(index));
  }
}

void Swarm::on_tick(Clock::time_point now) {
  for (Client& client : clients_) {
    if (client.unacknowledged.empty() || now - client.sent_at < retry_interval) continue;
    constexpr std::size_t flags_offset = 2;  // of a PUBLISH with one octet of Length
    if (client.state == State::ready) client.unacknowledged[flags_offset] |= sn::flag_dup;
    client.sent_at = now;
    ++repeats_;
    transmit(client, client.unacknowledged);
  }
}

void Swarm::request(Client& client, sim::Bytes datagram) {
  client.unacknowledged = std::move(datagram);
  client.sent_at = Clock::now();
  transmit(client, client.unacknowledged);
}

void Swarm::start_next(Client& client) {
  if (++client.msg_id == 0) ++client.msg_id;
  const Bytes payload = to_payload(client.waiting.front());
  client.waiting.pop_front();
  client.is_busy = true;
  ++busy_;
  request(client, sn::publish(1, client.topic_id, client.msg_id, payload));
}

/// A datagram that the kernel does not accept is lost, as on a radio.
void Swarm::transmit(const Client& client, sim::ByteView datagram) {
  (void)::send(client.descriptor, datagram.data(), datagram.size(), MSG_NOSIGNAL);
}

}  // namespace slamgw::bench
