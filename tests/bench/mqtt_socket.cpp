// SPDX-License-Identifier: Apache-2.0
#include "tests/bench/mqtt_socket.hpp"

#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <stdexcept>

namespace slamgw::bench {
namespace {

constexpr std::uint8_t connect_packet = 0x10;
constexpr std::uint8_t connack = 0x20;
constexpr std::uint8_t publish_packet = 0x30;
constexpr std::uint8_t puback = 0x40;
constexpr std::uint8_t subscribe_packet = 0x82;
constexpr std::uint8_t suback = 0x90;
constexpr std::size_t read_bytes = 65536;

void put_u16(Bytes& out, std::size_t value) {
  out.push_back(static_cast<std::uint8_t>(value >> 8));
  out.push_back(static_cast<std::uint8_t>(value & 0xff));
}

void put_text(Bytes& out, std::string_view text) {
  put_u16(out, text.size());
  out.insert(out.end(), text.begin(), text.end());
}

std::size_t u16_at(ByteView bytes, std::size_t offset) {
  return static_cast<std::size_t>(bytes[offset] << 8 | bytes[offset + 1]);
}

}  // namespace

MqttSocket::MqttSocket(const Address& broker, std::string_view client_id)
    : descriptor_(open_connected(broker, SOCK_STREAM)) {
  const int on = 1;
  setsockopt(descriptor_, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  Bytes body;
  put_text(body, "MQTT");
  body.insert(body.end(), {4, 0x02, 0, 0});  // version, clean session, no keep-alive
  put_text(body, client_id);
  add_packet(connect_packet, body);
  await(connack);
}

MqttSocket::~MqttSocket() { close(descriptor_); }

void MqttSocket::subscribe(std::string_view filter, unsigned qos) {
  Bytes body{0, 1};
  put_text(body, filter);
  body.push_back(static_cast<std::uint8_t>(qos));
  add_packet(subscribe_packet, body);
  await(suback);
}

void MqttSocket::publish(std::string_view topic, ByteView payload, unsigned qos, std::uint16_t id) {
  Bytes body;
  put_text(body, topic);
  if (qos > 0) put_u16(body, id);
  body.insert(body.end(), payload.begin(), payload.end());
  add_packet(static_cast<std::uint8_t>(publish_packet | qos << 1), body);
}

void MqttSocket::flush() {
  std::size_t sent = 0;
  while (sent < out_.size()) {
    const ssize_t count = send(descriptor_, out_.data() + sent, out_.size() - sent, MSG_NOSIGNAL);
    if (count < 0) throw std::runtime_error("the broker has closed the connection");
    sent += static_cast<std::size_t>(count);
  }
  out_.clear();
}

void MqttSocket::on_readable() {
  const std::size_t before = in_.size();
  in_.resize(before + read_bytes);
  const ssize_t count = recv(descriptor_, in_.data() + before, read_bytes, MSG_DONTWAIT);
  in_.resize(before + static_cast<std::size_t>(std::max<ssize_t>(count, 0)));
  if (count == 0) throw std::runtime_error("the broker has closed the connection");
  parse_packets();
  flush();
}

/// Blocks, so call it only while nothing is measured.
void MqttSocket::await(std::uint8_t type) {
  flush();
  for (std::uint8_t last = 0; last != type; last = parse_packets()) {
    std::uint8_t byte = 0;
    if (recv(descriptor_, &byte, 1, 0) != 1) throw std::runtime_error("the broker does not answer");
    in_.push_back(byte);
  }
}

/// The first byte of the last whole packet, or 0.
std::uint8_t MqttSocket::parse_packets() {
  std::size_t begin = 0;
  std::uint8_t last = 0;
  while (begin < in_.size()) {
    std::size_t length = 0;
    std::size_t at = begin + 1;
    unsigned shift = 0;
    bool is_whole = false;
    while (at < in_.size() && !is_whole) {
      length |= static_cast<std::size_t>(in_[at] & 0x7f) << shift;
      shift += 7;
      is_whole = (in_[at++] & 0x80) == 0;
    }
    if (!is_whole || in_.size() - at < length) break;
    last = in_[begin];
    on_packet(last, ByteView(in_).subspan(at, length));
    begin = at + length;
  }
  in_.erase(in_.begin(), in_.begin() + static_cast<std::ptrdiff_t>(begin));
  return last;
}

void MqttSocket::on_packet(std::uint8_t first, ByteView body) {
  if ((first & 0xf0) == publish_packet) {
    const unsigned qos = first >> 1 & 3;
    std::size_t at = 2 + u16_at(body, 0);
    if (qos > 0) {
      Bytes id;
      put_u16(id, u16_at(body, at));
      add_packet(puback, id);
      at += 2;
    }
    if (on_message) on_message(body.subspan(at));
  } else if (first == puback && on_puback) {
    on_puback(static_cast<std::uint16_t>(u16_at(body, 0)));
  }
}

void MqttSocket::add_packet(std::uint8_t first, const Bytes& body) {
  out_.push_back(first);
  std::size_t length = body.size();
  do {
    out_.push_back(static_cast<std::uint8_t>((length & 0x7f) | (length > 0x7f ? 0x80 : 0)));
    length >>= 7;
  } while (length > 0);
  out_.insert(out_.end(), body.begin(), body.end());
}

}  // namespace slamgw::bench
