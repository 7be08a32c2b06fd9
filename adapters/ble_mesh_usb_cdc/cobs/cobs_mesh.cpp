// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/cobs/cobs_mesh.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <boost/crc.hpp>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/robots/robots.hpp"

namespace slamgw::ble {

namespace {

constexpr std::uint8_t full_block = 0xff;  // 254 octets without a zero after them

}  // namespace

// encoded = block ...; block = code data: `code - 1` octets without zero. A zero follows in the
// data after each block but the last and full ones.
Bytes encode_cobs(ByteView data) {
  Bytes encoded{1};
  std::size_t code_at = 0;
  for (std::size_t i = 0; i < data.size(); ++i) {
    if (data[i] != 0) {
      encoded.push_back(data[i]);
      ++encoded[code_at];
    }
    const bool is_last = i + 1 == data.size();
    if (data[i] == 0 || (encoded[code_at] == full_block && !is_last)) {
      code_at = encoded.size();
      encoded.push_back(1);
    }
  }
  return encoded;
}

Result<Bytes, DecodeError> decode_cobs(ByteView encoded) {
  Bytes data;
  if (encoded.empty()) return DecodeError::too_short;
  while (!encoded.empty()) {
    const std::uint8_t code = encoded.front();
    if (code == 0) return DecodeError::bad_value;
    if (encoded.size() < code) return DecodeError::too_short;
    const ByteView block = encoded.subspan(1, code - std::size_t{1});
    if (std::ranges::find(block, 0) != block.end()) return DecodeError::bad_value;
    data.insert(data.end(), block.begin(), block.end());
    encoded = encoded.subspan(code);
    if (code != full_block && !encoded.empty()) data.push_back(0);
  }
  return data;
}

std::vector<Bytes> CobsSplitter::on_bytes(ByteView bytes) {
  std::vector<Bytes> frames;
  for (const std::uint8_t byte : bytes) {
    if (byte != 0) {
      if (is_skipping_) continue;
      partial_.push_back(byte);
      if (partial_.size() <= max_frame) continue;
      ++oversize_;
      is_skipping_ = true;
      partial_.clear();
      continue;
    }
    if (!partial_.empty()) frames.push_back(std::exchange(partial_, {}));
    is_skipping_ = false;
  }
  return frames;
}

void CobsSplitter::reset() {
  partial_.clear();
  is_skipping_ = true;
}

namespace {

constexpr std::size_t shortest_frame = 4;  // a frame without data

}  // namespace

std::uint8_t crc8_maxim(ByteView bytes) {
  boost::crc_optimal<8, 0x31, 0, 0, true, true> crc;
  crc.process_bytes(bytes.data(), bytes.size());
  return crc.checksum();
}

Bytes encode_lien_frame(const LienFrame& frame) {
  ByteWriter raw;
  raw.write_u8(frame.destination)
      .write_u8(frame.source)
      .write_u8(static_cast<std::uint8_t>(frame.protocol))
      .write(frame.data);
  raw.write_u8(crc8_maxim(raw.bytes()));
  Bytes wire = encode_cobs(raw.bytes());
  wire.push_back(0);
  return wire;
}

Result<LienFrame, DecodeError> decode_lien_frame(ByteView raw) {
  if (raw.size() < shortest_frame) return DecodeError::too_short;
  const ByteView covered = raw.first(raw.size() - 1);
  if (crc8_maxim(covered) != raw.back() || covered[2] > 1) return DecodeError::bad_value;
  return LienFrame{covered[0], covered[1], LienProtocol{covered[2]},
                   Bytes(covered.begin() + 3, covered.end())};
}

std::optional<std::string_view> lien_type_name(std::uint8_t message_type) {
  constexpr std::array<std::string_view, 16> names{"handshake",
                                                   "lien_update",
                                                   "",
                                                   "idle",
                                                   "",
                                                   "",
                                                   "",
                                                   "",
                                                   "",
                                                   "ping_response",
                                                   "line",
                                                   "debug",
                                                   "drone_update",
                                                   "battery",
                                                   "line_update",
                                                   "repo_update"};
  if (message_type >= names.size() || names[message_type].empty()) return std::nullopt;
  return names[message_type];
}

namespace {

constexpr std::uint8_t number_mask = 0x7f;
constexpr std::size_t length_octets = 2;

}  // namespace

std::optional<Bytes> LienConnection::on_simple(ByteView data) {
  ByteReader reader(data);
  const std::uint8_t part = reader.read_u8();
  const std::uint8_t last_part = reader.read_u8();
  if (!reader.ok() || part > last_part) return std::nullopt;
  if (part == 0) {
    parts_.clear();
    next_part_ = 0;
  }
  const ByteView content = reader.read_rest();
  if (part != next_part_ || parts_.size() + content.size() > max_message) {
    parts_.clear();
    next_part_ = 0;
    return std::nullopt;  // a part was lost, and so is the message
  }
  parts_.insert(parts_.end(), content.begin(), content.end());
  ++next_part_;
  if (part != last_part) return std::nullopt;
  next_part_ = 0;
  Bytes message = std::exchange(parts_, {});
  if (message.empty()) return std::nullopt;
  return message;
}

LienConnection::ArqOutcome LienConnection::on_arq(ByteView data) {
  ByteReader reader(data);
  const std::uint8_t kind = reader.read_u8();
  if (!reader.ok()) return {};
  if (kind == static_cast<std::uint8_t>(Segment::syn)) {
    is_connected_ = true;
    is_open_ = false;
    expected_ = 0;
    stream_.clear();
    return {.reply = Bytes{static_cast<std::uint8_t>(Segment::synack)}, .is_new_connection = true};
  }
  const std::uint8_t number = reader.read_u8();
  // Without a connection the robot gets no answer, gives up after 1 s and connects again.
  if (!reader.ok() || !is_connected_) return {};
  if (kind == static_cast<std::uint8_t>(Segment::data))
    return on_segment(number & number_mask, reader.read_rest());
  if (kind == static_cast<std::uint8_t>(Segment::alive_test)) return {.reply = acknowledge()};
  return {};  // the robot's ACK of the SYNACK
}

LienConnection::ArqOutcome LienConnection::on_segment(std::uint8_t number, ByteView payload) {
  if (is_open_) return {};
  if (number != expected_) return {.reply = acknowledge()};
  stream_before_ = stream_.size();
  stream_.insert(stream_.end(), payload.begin(), payload.end());
  if (stream_.size() > max_message + length_octets) {
    is_connected_ = false;  // no robot sends such a long message: start over
    return {};
  }
  auto message = complete_message();
  is_open_ = message.has_value();
  if (is_open_) return {.message = std::move(message)};
  if (stream_.size() >= length_octets && stream_[0] == 0 && stream_[1] == 0)
    stream_.clear();  // an empty message
  expected_ = (expected_ + 1) & number_mask;
  return {.reply = acknowledge()};
}

std::optional<Bytes> LienConnection::complete_message() const {
  ByteReader reader(stream_);
  const std::uint16_t length = reader.read_u16_le();
  const ByteView message = reader.read(length);
  if (!reader.ok() || message.empty()) return std::nullopt;
  return Bytes(message.begin(), message.end());
}

Bytes LienConnection::on_safe() {
  is_open_ = false;
  stream_.clear();
  expected_ = (expected_ + 1) & number_mask;
  return acknowledge();
}

void LienConnection::on_refused() {
  is_open_ = false;
  stream_.resize(stream_before_);
}

Bytes LienConnection::acknowledge() const {
  return {static_cast<std::uint8_t>(Segment::ack), expected_};
}

namespace {

constexpr std::uint8_t only_peer = 0;  // key of the only robot, with positions
constexpr std::size_t lien_position_bytes = 4;

}  // namespace

CobsMesh::CobsMesh(Settings settings, TopicScheme topics, RobotNames names)
    : settings_(std::move(settings)), topics_(std::move(topics)), names_(std::move(names)) {
  if (settings_.cobs_content == CobsContent::positions)
    peers_[only_peer] = Peer{.id = settings_.robot_id.value_or(""), .address = "serial"};
}

void CobsMesh::on_start() {
  for (const auto& [address, peer] : peers_) subscribe(peer, /*is_here=*/false);
  add_configured(/*is_start=*/true);
}

void CobsMesh::add_configured(bool is_start) {
  if (settings_.cobs_content != CobsContent::lien) return;
  for (const RobotName& name : names_.configured()) {
    if (!name.ble_address || *name.ble_address > 0xff) continue;
    const auto address = static_cast<std::uint8_t>(*name.ble_address);
    if (!peers_.contains(address)) subscribe(lien_peer(address), !is_start);
  }
}

void CobsMesh::on_port_open(TimePoint) {
  splitter_.reset();
  if (std::exchange(is_up_, true)) return;
  down_reason_.clear();
  emit(LinkChange{Mesh::ble, true, "listening for COBS frames"});
}

void CobsMesh::on_port_closed(const std::string& why, TimePoint) {
  is_up_ = false;
  if (std::exchange(down_reason_, why) == why) return;
  emit(LinkChange{Mesh::ble, false, why});
}

void CobsMesh::on_names(RobotNames names, TimePoint) {
  names_ = std::move(names);
  if (settings_.cobs_content == CobsContent::lien) rename_peers();
  for (auto& [address, peer] : peers_) {
    if (!names_.bans().has(peer.id) || !std::exchange(peer.is_online, false)) continue;
    emit(PresenceChange{Mesh::ble, peer.id, Presence::offline, peer.address});
  }
}

void CobsMesh::rename_peers() {
  std::vector<Peer*> renamed;
  for (auto& [address, peer] : peers_) {
    const std::string id = names_.of_ble(address);
    if (id == peer.id) continue;
    if (peer.is_online) emit(PresenceChange{Mesh::ble, peer.id, Presence::offline, peer.address});
    emit(UnsubscribeRequest{Mesh::ble, peer.id, topics_.command_filter(peer.id)});
    peer.id = id;
    peer.is_subscribed = true;
    renamed.push_back(&peer);
  }
  for (const Peer* peer : renamed) {  // after all have left their names: two may have swapped
    subscribe(*peer, /*is_here=*/true);
    if (peer->is_online) emit(PresenceChange{Mesh::ble, peer->id, Presence::online, peer->address});
  }
  add_configured(/*is_start=*/false);
}

// --- Up ------------------------------------------------------------------------------------------

void CobsMesh::on_bytes(ByteView bytes, TimePoint now) {
  const std::uint64_t oversize_before = splitter_.oversize();
  for (const Bytes& frame : splitter_.on_bytes(bytes)) on_frame(frame, now);
  if (splitter_.oversize() != oversize_before) reject("it is too long", now);
}

void CobsMesh::on_frame(const Bytes& encoded, TimePoint now) {
  const auto decoded = decode_cobs(encoded);
  if (!decoded.has_value()) return reject("it is not a COBS frame", now);
  switch (settings_.cobs_content) {
    case CobsContent::positions: {
      Peer& peer = peers_.at(only_peer);
      if (names_.bans().has(peer.id)) break;
      on_heard(peer, now);
      report(peer, settings_.sensor_update_type, *decoded, nullptr);
      break;
    }
    case CobsContent::lien: {
      const auto frame = decode_lien_frame(*decoded);
      if (!frame.has_value()) return reject("its CRC-8 or protocol is wrong", now);
      on_lien_frame(*frame, now);
      break;
    }
  }
}

void CobsMesh::on_lien_frame(const LienFrame& frame, TimePoint now) {
  if (frame.destination != lien_server_address || frame.source == lien_server_address) return;
  const Bans& bans = names_.bans();
  if (!bans.ids().empty() && bans.has(names_.of_ble(frame.source))) return;
  Peer& peer = lien_peer(frame.source);
  on_heard(peer, now);
  if (frame.protocol == LienProtocol::simple) {
    if (const auto message = peer.connection.on_simple(frame.data))
      on_lien_message(peer, *message, nullptr);
    return;
  }
  const LienConnection::ArqOutcome outcome = peer.connection.on_arq(frame.data);
  if (outcome.is_new_connection) peer.open = {};
  if (outcome.reply) reply(frame.source, *outcome.reply);
  if (outcome.message) on_lien_message(peer, *outcome.message, peer.open.data());
}

void CobsMesh::on_lien_message(const Peer& peer, ByteView message, Part* parts) {
  // Servers know only the position as an update. The whole message, with heading and distances,
  // follows.
  if (message.front() == lien_update_message && message.size() > lien_position_bytes)
    report(peer, settings_.sensor_update_type, message.subspan(1, lien_position_bytes),
           parts != nullptr ? parts + 1 : nullptr);
  // The type octet stays in the payload: old servers would read 4n octets as coordinates.
  const auto known = lien_type_name(message.front());
  report(peer, known ? std::string(*known) : fmt::format("lien_{}", message.front()), message,
         parts);
}

void CobsMesh::on_receipt(std::uint64_t receipt_id, ReceiptOutcome outcome, TimePoint) {
  if (receipt_id == 0) return;
  for (auto& [address, peer] : peers_) {
    const auto part = std::ranges::find(peer.open, receipt_id, &Part::receipt);
    if (part == peer.open.end()) continue;
    *part = {.outcome = outcome};
    if (!std::ranges::all_of(peer.open, [](const Part& each) { return each.receipt == 0; })) return;
    if (std::ranges::find(peer.open, ReceiptOutcome::refused, &Part::outcome) != peer.open.end())
      return peer.connection.on_refused();
    peer.open = {};
    return reply(address, peer.connection.on_safe());
  }
}

void CobsMesh::reply(std::uint8_t address, const Bytes& data) {
  if (!is_up_) return;  // the robot asks again
  actions_.push(
      WriteSerial{encode_lien_frame({address, lien_server_address, LienProtocol::arq, data})});
}

void CobsMesh::report(const Peer& peer, std::string_view type, ByteView payload, Part* part) {
  if (part != nullptr && part->outcome == ReceiptOutcome::safe) return;
  if (part != nullptr) part->receipt = ++last_receipt_;
  ++reports_;
  emit(Report{.mesh = Mesh::ble,
              .robot = peer.id,
              .topic = topics_.robot_topic(peer.id, type),
              .payload = {payload.begin(), payload.end()},
              .qos = Qos::at_least_once,
              .retain = false,
              .receipt = {Mesh::ble, part != nullptr ? part->receipt : 0}});
}

void CobsMesh::reject(std::string_view why, TimePoint now) {
  ++rejected_;
  if (const auto count = reject_throttle_.on_event(now))
    emit(Notice{
        Severity::warning,
        fmt::format("{} frame(s) from the serial line rejected, the last because {}", *count, why),
        {}});
}

// --- Presence ------------------------------------------------------------------------------------

CobsMesh::Peer& CobsMesh::lien_peer(std::uint8_t address) {
  const auto [peer, is_new] = peers_.try_emplace(address);
  if (is_new) {
    peer->second.id = names_.of_ble(address);
    peer->second.address = fmt::format("0x{:04x}", address);
  }
  return peer->second;
}

void CobsMesh::on_heard(Peer& peer, TimePoint now) {
  peer.last_heard = now;
  if (std::exchange(peer.is_online, true)) return;
  emit(PresenceChange{Mesh::ble, peer.id, Presence::online, peer.address});
  subscribe(peer, /*is_here=*/true);
}

void CobsMesh::subscribe(const Peer& peer, bool is_here) {
  emit(SubscribeRequest{Mesh::ble, peer.id, topics_.command_filter(peer.id), Qos::at_least_once,
                        /*is_standing=*/!is_here});
}

void CobsMesh::on_subscribe_result(const std::string& robot, const std::string&, bool granted,
                                   TimePoint) {
  for (auto& [address, peer] : peers_)
    if (peer.id == robot) peer.is_subscribed = granted;
}

std::vector<WaitingMessage> CobsMesh::give_up(const std::string& robot, TimePoint) {
  for (auto& [address, peer] : peers_) {
    if (peer.id != robot) continue;
    peer.is_online = false;
    peer.is_subscribed = true;
  }
  return {};
}

void CobsMesh::on_broker_link(bool is_up, TimePoint) {
  if (!is_up) return;
  for (auto& [address, peer] : peers_)
    if (!std::exchange(peer.is_subscribed, true)) subscribe(peer, /*is_here=*/true);
}

void CobsMesh::on_broker_message(const RobotMessage& what, TimePoint) {
  const auto target = topics_.parse_command_topic(what.message.topic);
  if (!target || what.command == CommandId::none || !presence_of(what.robot)) return;
  emit(CommandOutcome{Mesh::ble, what.command, what.robot, std::string(target->type),
                      CommandResult::refused, what.message.waited,
                      "not supported by this link (ble_mesh.protocol is \"cobs\")"});
}

std::optional<TimePoint> CobsMesh::deadline() const {
  std::optional<TimePoint> next;
  for (const auto& [address, peer] : peers_)
    if (peer.is_online) next = earlier(next, peer.last_heard + settings_.offline_after);
  return next;
}

void CobsMesh::on_deadline(TimePoint now) {
  for (auto& [address, peer] : peers_) {
    if (!peer.is_online || now < peer.last_heard + settings_.offline_after) continue;
    peer.is_online = false;
    emit(PresenceChange{Mesh::ble, peer.id, Presence::offline, peer.address});
    if (settings_.will) emit(will_report(*settings_.will, peer.id));
  }
}

std::optional<Presence> CobsMesh::presence_of(std::string_view robot) const {
  for (const auto& [address, peer] : peers_)
    if (peer.id == robot) return peer.is_online ? Presence::online : Presence::offline;
  return std::nullopt;
}

Counters CobsMesh::counters() const {
  const auto online =
      std::ranges::count_if(peers_, [](const auto& entry) { return entry.second.is_online; });
  return {{"robots_online", static_cast<std::uint64_t>(online)},
          {"reports", reports_},
          {"rejected", rejected_}};
}

}  // namespace slamgw::ble
