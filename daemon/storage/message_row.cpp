// SPDX-License-Identifier: Apache-2.0
#include "daemon/storage/message_row.hpp"

#include <array>
#include <boost/crc.hpp>
#include <chrono>
#include <iterator>

namespace slamgw {
namespace {

class Checksum {
 public:
  Checksum& add(std::int64_t number) {
    std::array<std::uint8_t, 8> octets{};
    for (std::size_t i = 0; i < octets.size(); ++i) {
      octets[i] = static_cast<std::uint8_t>(static_cast<std::uint64_t>(number) >> (8 * i));
    }
    crc_.process_bytes(octets.data(), octets.size());
    return *this;
  }
  Checksum& add(ByteView bytes) {
    add(static_cast<std::int64_t>(bytes.size()));
    crc_.process_bytes(bytes.data(), bytes.size());
    return *this;
  }
  Checksum& add(std::string_view text) { return add(as_bytes(text)); }
  Checksum& add(const MessageRow& row) {
    return add(row.row)
        .add(row.topic)
        .add(row.payload)
        .add(row.qos)
        .add(row.retain)
        .add(row.stored_at)
        .add(row.mesh)
        .add(row.received_at);
  }
  std::uint32_t value() const { return crc_.checksum(); }

 private:
  boost::crc_32_type crc_;
};

std::int64_t milliseconds_since_1970(WallTime time) {
  return std::chrono::duration_cast<std::chrono::milliseconds>(time.time_since_epoch()).count();
}

}  // namespace

std::uint32_t checksum(const MessageRow& row) { return Checksum().add(row).value(); }

std::uint32_t checksum(const DeadLetterRow& row) {
  return Checksum()
      .add(row.message)
      .add(row.reason)
      .add(row.code)
      .add(row.tries)
      .add(row.set_aside_at)
      .value();
}

std::uint32_t checksum(const StoreContents& contents) {
  return Checksum()
      .add(contents.file)
      .add(contents.commits)
      .add(contents.messages)
      .add(contents.dead_letters)
      .add(contents.dead_letter_bytes)
      .add(contents.first_row)
      .add(contents.last_row)
      .value();
}

MessageRow row_of(std::uint64_t row, const BrokerMessage& message, std::int64_t stored_at) {
  MessageRow values;
  values.row = static_cast<std::int64_t>(row);
  values.topic = message.topic;
  values.payload = message.payload;
  values.qos = static_cast<std::int64_t>(message.qos);
  values.retain = message.retain ? 1 : 0;
  values.stored_at = stored_at;
  if (message.provenance) {
    values.mesh = 1 + static_cast<std::int64_t>(index_of(message.provenance->mesh));
    values.received_at = milliseconds_since_1970(message.provenance->received_at);
  }
  return values;
}

BrokerMessage message_of(const MessageRow& row) {
  BrokerMessage message;
  message.topic = row.topic;
  message.payload.assign(row.payload.begin(), row.payload.end());
  message.qos = row.qos == 2 ? Qos::exactly_once : Qos::at_least_once;
  message.retain = row.retain != 0;
  if (row.mesh > 0 && row.mesh <= std::ssize(all_meshes)) {
    message.provenance = Provenance{static_cast<Mesh>(row.mesh - 1),
                                    WallTime{std::chrono::milliseconds{row.received_at}}};
  }
  return message;
}

MessageRow message_row_at(const SqliteStatement& statement) {
  return {statement.number(0), statement.text(1),   statement.bytes(2),  statement.number(3),
          statement.number(4), statement.number(5), statement.number(6), statement.number(7)};
}

}  // namespace slamgw
