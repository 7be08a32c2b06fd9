// SPDX-License-Identifier: Apache-2.0
#include "tests/support/fake_broker.hpp"

#include <algorithm>
#include <boost/asio/write.hpp>
#include <optional>
#include <utility>

namespace slamgw::test {
namespace {

using boost::asio::ip::tcp;
using Error = boost::system::error_code;
using Octets = FakeBroker::Octets;

constexpr std::size_t level_at = 6;  // after "MQTT" and its length
constexpr std::uint8_t level_of_mqtt5 = 5;

std::size_t u16_at(const Octets& octets, std::size_t at) {
  return at + 1 < octets.size() ? static_cast<std::size_t>(octets[at] << 8 | octets[at + 1]) : 0;
}

/// Returns a variable byte integer and its size in octets; nothing while it is incomplete.
std::optional<std::pair<std::size_t, std::size_t>> length_at(const Octets& octets, std::size_t at) {
  std::size_t value = 0;
  for (std::size_t i = 0; i < 4 && at + i < octets.size(); ++i) {
    value |= static_cast<std::size_t>(octets[at + i] & 0x7f) << (7 * i);
    if (octets[at + i] < 0x80) return std::pair(value, i + 1);
  }
  return std::nullopt;
}

std::string text_of(const Octets& octets, std::size_t begin, std::size_t end) {
  begin = std::min(begin, octets.size());
  end = std::clamp(end, begin, octets.size());
  return {octets.begin() + static_cast<std::ptrdiff_t>(begin),
          octets.begin() + static_cast<std::ptrdiff_t>(end)};
}

}  // namespace

bool FakeBroker::Packet::contains(std::string_view text) const {
  return std::search(body.begin(), body.end(), text.begin(), text.end()) != body.end();
}

FakeBroker::FakeBroker()
    : acceptor_(io_, {boost::asio::ip::address_v4::loopback(), 0}),
      port_(acceptor_.local_endpoint().port()) {
  accept();
  thread_ = std::thread([this] { io_.run(); });
}

FakeBroker::~FakeBroker() {
  io_.stop();
  thread_.join();
}

void FakeBroker::misbehave(Misbehaviour misbehaviour) {
  const std::lock_guard lock(mutex_);
  misbehaviour_ = std::move(misbehaviour);
}

std::vector<std::string> FakeBroker::arrived() const {
  const std::lock_guard lock(mutex_);
  return arrived_;
}

void FakeBroker::accept() {
  acceptor_.async_accept([this](Error error, tcp::socket socket) {
    if (error) return;
    ++connections_;
    std::make_shared<Connection>(*this, std::move(socket))->read();
    accept();
  });
}

bool FakeBroker::misbehaves(Connection& connection, const Packet& packet) {
  Misbehaviour misbehaviour;
  {
    const std::lock_guard lock(mutex_);
    misbehaviour = misbehaviour_;
  }
  return misbehaviour && misbehaviour(connection, packet);
}

void FakeBroker::on_arrived(std::string message) {
  const std::lock_guard lock(mutex_);
  arrived_.push_back(std::move(message));
}

FakeBroker::Connection::Connection(FakeBroker& broker, tcp::socket socket)
    : broker_(broker), socket_(std::move(socket)) {
  Error ignored;
  socket_.set_option(tcp::no_delay(true), ignored);
}

void FakeBroker::Connection::send(const Octets& octets) {
  Error ignored;
  boost::asio::write(socket_, boost::asio::buffer(octets), ignored);
}

void FakeBroker::Connection::send(std::uint8_t first, const Octets& body) {
  Octets octets{first};
  std::size_t left = body.size();
  do {
    octets.push_back(static_cast<std::uint8_t>(left % 128 | (left >= 128 ? 0x80 : 0)));
    left /= 128;
  } while (left > 0);
  octets.insert(octets.end(), body.begin(), body.end());
  send(octets);
}

void FakeBroker::Connection::close() {
  Error ignored;
  socket_.shutdown(tcp::socket::shutdown_both, ignored);
  socket_.close(ignored);
}

void FakeBroker::Connection::read() {
  socket_.async_read_some(
      boost::asio::buffer(chunk_), [self = shared_from_this()](Error error, std::size_t size) {
        if (error) return self->close();
        self->buffer_.insert(self->buffer_.end(), self->chunk_.begin(),
                             self->chunk_.begin() + static_cast<std::ptrdiff_t>(size));
        while (self->take_packet()) {
        }
        if (self->socket_.is_open()) self->read();
      });
}

/// Returns false when no packet is complete.
bool FakeBroker::Connection::take_packet() {
  const auto length = length_at(buffer_, 1);
  if (!socket_.is_open() || !length) return false;
  const std::size_t begin = 1 + length->second;
  const std::size_t end = begin + length->first;
  if (buffer_.size() < end) return false;
  const auto at = [&](std::size_t octet) {
    return buffer_.begin() + static_cast<std::ptrdiff_t>(octet);
  };
  const Packet packet{buffer_[0], Octets(at(begin), at(end))};
  buffer_.erase(at(0), at(end));
  ++packets_;
  if (packet.type() == connect && packet.body.size() > level_at)
    is_v5_ = packet.body[level_at] == level_of_mqtt5;
  if (!broker_.misbehaves(*this, packet) && socket_.is_open()) answer(packet);
  return true;
}

void FakeBroker::Connection::answer(const Packet& packet) {
  switch (packet.type()) {
    case connect: return send(connack << 4, is_v5_ ? Octets{0, 0, 0} : Octets{0, 0});
    case publish: return answer_publish(packet);
    case pubrel: return acknowledge(pubcomp << 4, packet);
    case subscribe: {
      constexpr std::uint8_t granted_qos = 1;
      const auto id = static_cast<std::uint16_t>(u16_at(packet.body, 0));
      Octets body{static_cast<std::uint8_t>(id >> 8), static_cast<std::uint8_t>(id)};
      if (is_v5_) body.push_back(0);
      body.push_back(granted_qos);
      return send(suback << 4, body);
    }
    case unsubscribe: {
      Octets body{packet.body[0], packet.body[1]};
      if (is_v5_) body.insert(body.end(), {0, 0});
      return send(unsuback << 4, body);
    }
    case pingreq: return send(pingresp << 4, {});
    case disconnect: return close();
    default: return;
  }
}

void FakeBroker::Connection::answer_publish(const Packet& packet) {
  const unsigned qos = packet.first >> 1 & 3;
  const std::size_t topic_end = 2 + u16_at(packet.body, 0);
  std::size_t payload_at = topic_end + (qos > 0 ? 2 : 0);
  if (is_v5_) {
    const auto properties = length_at(packet.body, payload_at);
    if (!properties) return close();
    payload_at += properties->first + properties->second;
  }
  broker_.on_arrived(text_of(packet.body, 2, topic_end) + " " +
                     text_of(packet.body, payload_at, packet.body.size()));
  if (qos == 1) acknowledge(puback << 4, packet, topic_end);
  if (qos == 2) acknowledge(pubrec << 4, packet, topic_end);
}

void FakeBroker::Connection::acknowledge(std::uint8_t first, const Packet& packet,
                                         std::size_t id_at) {
  if (id_at + 1 >= packet.body.size()) return close();
  send(first, {packet.body[id_at], packet.body[id_at + 1]});
}

}  // namespace slamgw::test
