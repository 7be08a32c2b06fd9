// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/network.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>

namespace slamgw::sim::ble {
namespace {

using Use = Random::Use;

Key to_key(const Bytes& octets) {
  Key key{};
  std::copy_n(octets.begin(), std::min(octets.size(), key.size()), key.begin());
  return key;
}

std::uint8_t ttl_of(const BleOptions& options) {
  return static_cast<std::uint8_t>(std::max<unsigned>(default_ttl, options.hops));
}

RobotSettings robot_settings(const BleOptions& options, unsigned number) {
  RobotSettings settings;
  settings.address =
      options.is_unprovisioned ? Address{0} : static_cast<Address>(first_robot + number - 1);
  settings.number = number;
  settings.ttl = ttl_of(options);
  settings.is_acknowledged = options.is_acknowledged;
  settings.is_numbered = options.is_numbered;
  settings.has_segment_timing = options.has_segment_timing;
  settings.obeys = options.common.obeys;
  settings.is_recorded = options.common.is_recorded();
  settings.on_busy = options.on_busy;
  settings.messages = options.common.limit();
  settings.period = options.common.period();
  return settings;
}

RadioSettings radio_settings(const BleOptions& options) {
  RadioSettings settings;
  const HopOptions& hop = options.common.hop;
  settings.hops = options.hops;
  settings.hop_loss.resize(options.hops);
  for (unsigned i = 0; i < options.hops; ++i) {
    settings.hop_loss[i] = 1 - (1 - options.common.loss) * (1 - hop.loss_of(i));
  }
  for (unsigned i = 0; i < options.hops && !hop.delay_ms.empty(); ++i) {
    settings.hop_delay.push_back(std::chrono::duration_cast<Duration>(
        std::chrono::duration<double, std::milli>(hop.delay_ms_of(i))));
  }
  settings.bearer_interval = std::chrono::milliseconds{options.bearer_interval_ms};
  return settings;
}

template <class Value>
Value value_of(const std::vector<Value>& values, std::size_t index) {
  return values.empty() ? Value{} : values[std::min(index, values.size() - 1)];
}

/// Attenuation of a fading board just before it receives nothing.
constexpr double fade_db = 40;

/// Returns a fade from 0 to 1, where the board receives nothing, and back, once in `period_s`.
double fading_of(double period_s, TimePoint now) {
  if (period_s <= 0) return 0;
  const double seconds = std::chrono::duration<double>(now.time_since_epoch()).count();
  const double phase = std::fmod(seconds, period_s) / period_s;
  return 1 - std::abs(1 - 2 * phase);
}

/// Repeats segments to a unicast address until they are acknowledged. `transmit` sends them once,
/// at the given time. Returns the time of the repeats, or nothing when the message has failed.
template <class Transmit>
std::optional<Duration> transmit_until_acknowledged(std::uint8_t ttl, TimePoint now,
                                                    Transmit&& transmit) {
  for (int i = 0; i < segmented_transmissions; ++i) {
    const Duration repeats = retry_interval(ttl) * i;
    if (transmit(now + repeats)) return repeats;
  }
  return std::nullopt;
}

/// Returns the prefix, octets that depend on the seed, and the robot's number in the last two.
Key make_uuid(const BleOptions& options, unsigned number) {
  Random random(options.common.seed, 0, Use::uuid);
  Key uuid = random_key(random);
  std::copy(options.uuid_prefix.begin(), options.uuid_prefix.end(), uuid.begin());
  uuid[14] = static_cast<std::uint8_t>(number >> 8);
  uuid[15] = static_cast<std::uint8_t>(number & 0xff);
  return uuid;
}

Node::Settings node_settings(const BleOptions& options, unsigned number) {
  Node::Settings settings;
  settings.firmware = options.firmware;
  settings.uuid = make_uuid(options, number);
  settings.number = number;
  if (!options.static_oob.empty()) settings.static_oob = to_key(options.static_oob);
  if (!options.is_unprovisioned) {
    settings.fixed_address = static_cast<Address>(first_robot + number - 1);
  }
  return settings;
}

}  // namespace

Network::Network(const BleOptions& options)
    : options_(options),
      radio_(radio_settings(options), Random(options.common.seed, 0, Use::radio)),
      pb_adv_(options.common.loss, Random(options.common.seed, 0, Use::pb_adv)) {
  constexpr unsigned beyond_all_robots = 0x8000;  // each board has its own random numbers
  for (unsigned i = 0; i < options.ttys.size(); ++i) {
    const unsigned number = i == 0 ? 0 : beyond_all_robots + i;
    boards_.emplace_back(
        *options.firmware, options.has_board_storage ? BoardStorage::flash : BoardStorage::none,
        Random(options.common.seed, number, Use::provisioning), options.octet_time());
  }
  if (options.is_configured) boards_[0].configure(to_key(options.net_key), to_key(options.app_key));
  for (unsigned number = 1; number <= options.common.robots; ++number) {
    robots_.emplace_back(robot_settings(options, number),
                         RobotBody(options.common.seed, number, options.common.body));
    nodes_.emplace_back(node_settings(options, number),
                        Random(options.common.seed, number, Use::provisioning));
  }
}

void Network::restore_node(unsigned number, NodeConfiguration configuration,
                           std::uint32_t next_sequence) {
  if (number == 0 || number > nodes_.size()) return;
  nodes_[number - 1].restore(std::move(configuration), next_sequence);
  robots_[number - 1].set_address(nodes_[number - 1].address());
}

void Network::on_start(TimePoint now) {
  for (Board& board : boards_) board.on_power_up();
  for (Node& node : nodes_) node.on_start(now);
  for (Robot& robot : robots_) robot.on_start(now);
  if (options_.has_heartbeats) next_heartbeats_ = now + heartbeat_interval;
}

void Network::on_host_bytes(ByteView bytes, TimePoint now, std::size_t board) {
  boards_[board].on_host_bytes(bytes, now);
  carry(now);
}

std::optional<std::pair<unsigned, UpdateEvent>> Network::next_event() {
  unsigned number = 0;
  for (Robot& robot : robots_) {
    ++number;
    if (auto event = robot.next_event()) return std::pair(number, std::move(*event));
  }
  return std::nullopt;
}

std::optional<std::pair<unsigned, std::string>> Network::next_failed_assertion() {
  if (failed_assertions_.empty()) return std::nullopt;
  auto first = std::move(failed_assertions_.front());
  failed_assertions_.pop_front();
  return first;
}

void Network::reboot_board(TimePoint now, Duration downtime, std::size_t board,
                           StartEvent start_event) {
  boards_[board].reboot(now, downtime, start_event);
}

void Network::reset_robot_by_hand(unsigned number, TimePoint now) {
  nodes_[number - 1].reset_by_hand(now);
  robots_[number - 1].set_address(nodes_[number - 1].address());
}

TimePoint Network::deadline() const {
  std::optional<TimePoint> next = radio_.next_arrival();
  for (const Board& board : boards_) next = first_of(next, board.deadline());
  next = first_of(first_of(next, pb_adv_.next_arrival()), next_heartbeats_);
  if (!transfers_.empty()) next = first_of(next, transfers_.begin()->first);
  for (const Node& node : nodes_) next = first_of(next, node.deadline());
  for (const Robot& robot : robots_) next = first_of(next, robot.deadline());
  return next.value_or(TimePoint::max());
}

void Network::on_deadline(TimePoint now) {
  if (!run_air(now) && !run_boards(now) && !run_nodes(now) && !run_heartbeats(now)) run_robots(now);
  carry(now);
}

bool Network::run_boards(TimePoint now) {
  for (Board& board : boards_) {
    if (const auto due = board.deadline(); !due || *due > now) continue;
    board.on_deadline(now);
    return true;
  }
  return false;
}

bool Network::run_air(TimePoint now) {
  if (std::optional<Reception> reception = radio_.take(now)) {
    deliver(*reception, now);
    return true;
  }
  if (std::optional<PbAdv::Arrival> arrival = pb_adv_.take(now)) {
    deliver(*arrival, now);
    return true;
  }
  if (transfers_.empty() || transfers_.begin()->first > now) return false;
  const Transfer ended = transfers_.begin()->second;
  transfers_.erase(transfers_.begin());
  boards_[ended.board].on_transfer_ended(ended.id, ended.is_acknowledged);
  return true;
}

bool Network::run_nodes(TimePoint now) {
  for (Node& node : nodes_) {
    if (!node.deadline() || *node.deadline() > now) continue;
    node.on_deadline(now);
    const std::optional<Key> uuid = node.next_beacon();
    const auto number = static_cast<std::uint16_t>(node.number());
    for (Board& board : boards_)
      if (uuid && !radio_.loses_beacon()) board.on_beacon({*uuid, number, radio_.rssi_dbm(number)});
    return true;
  }
  return false;
}

/// Delivers the heartbeats of all robots at once: those of as many robots as the board can hear fit
/// into its transmit buffer.
bool Network::run_heartbeats(TimePoint now) {
  if (!next_heartbeats_ || *next_heartbeats_ > now) return false;
  next_heartbeats_ = now + heartbeat_interval;
  for (const Node& node : nodes_) {
    if (node.address() == 0) continue;
    for (Board& board : boards_)
      if (!radio_.loses_message())
        board.on_heartbeat(node.address(), node.net_key(), ttl_of(options_),
                           static_cast<std::uint8_t>(options_.hops));
  }
  return true;
}

void Network::run_robots(TimePoint now) {
  const auto first =
      std::min_element(robots_.begin(), robots_.end(),
                       [](const Robot& a, const Robot& b) { return a.deadline() < b.deadline(); });
  if (first == robots_.end() || first->deadline() > now) return;
  first->on_deadline(publications_of(static_cast<std::size_t>(first - robots_.begin()), now), now);
}

bool Network::is_heard(Address destination, TimePoint now) {
  const auto any = [&](auto&& does) { return std::any_of(boards_.begin(), boards_.end(), does); };
  has_begun_ =
      has_begun_ || any([&](const Board& board) { return board.is_ready_for(destination, now); });
  return has_begun_ && any([&](const Board& board) { return board.hears(destination); });
}

/// Delays a robot's updates until a board can receive them, so that a run with --messages is
/// complete.
Robot::Publications Network::publications_of(std::size_t index, TimePoint now) {
  if (!options_.is_unprovisioned) return fixed_publications(now);
  Robot::Publications publications = nodes_[index].publications(now);
  for (auto* to : {&publications.min_com, &publications.sensor_update}) {
    if (*to && !is_heard((*to)->address, now)) to->reset();
  }
  return for_payload(publications);
}

/// Probes are messages of the min_com model, as the ones of the thesis's figure 7.1.
Robot::Publications Network::for_payload(Robot::Publications publications) const {
  const bool is_probe = options_.common.body.payload == BodySettings::Payload::probe;
  if (is_probe) publications.sensor_update = publications.min_com;
  return publications;
}

Robot::Publications Network::fixed_publications(TimePoint now) {
  const Address gateway = boards_[0].local_address();
  const std::uint8_t ttl = ttl_of(options_);
  Robot::Publications publications;
  if (is_heard(options_.is_unicast ? gateway : sensor_update_group, now)) {
    publications.min_com = {options_.is_unicast ? gateway : min_com_group, ttl, {}};
    publications.sensor_update = {options_.is_unicast ? gateway : sensor_update_group, ttl, {}};
  }
  if (gateway != 0) publications.health = {gateway, ttl, health_interval};
  return for_payload(publications);
}

/// Robots receive messages of boards only, and boards messages of robots only.
void Network::deliver(const Reception& reception, TimePoint now) {
  const MeshMessage& message = reception.message;
  if (reception.board) return boards_[*reception.board].on_radio(reception);
  for (std::size_t i = 0; i < nodes_.size(); ++i) {
    const bool was_gone = nodes_[i].failed_assertion().has_value();
    if (nodes_[i].on_message(message, now)) robots_[i].on_message(message, now);
    if (was_gone || !nodes_[i].failed_assertion()) continue;
    robots_[i].on_failed_assertion();
    failed_assertions_.emplace_back(nodes_[i].number(), *nodes_[i].failed_assertion());
  }
}

void Network::deliver(const PbAdv::Arrival& arrival, TimePoint now) {
  if (arrival.is_to_board) {
    for (Board& board : boards_) board.on_link_signal(arrival.signal, now);  // each knows its links
    return;
  }
  for (Node& node : nodes_) {
    if (node.takes(arrival.signal)) return node.on_link_signal(arrival.signal, now);
  }
}

void Network::carry(TimePoint now) {
  for (std::size_t i = 0; i < boards_.size(); ++i) carry_of_board(i, now);
  for (std::size_t i = 0; i < nodes_.size(); ++i) carry_of_robot(i, now);
}

void Network::carry_of_board(std::size_t index, TimePoint now) {
  Board& board = boards_[index];
  while (auto transmission = board.next_transmission()) {
    if (transmission->transfer) {
      begin_transfer(index, *transmission, now);
    } else {
      transmit_to_robots(index, transmission->message, now);
    }
  }
  while (auto signal = board.next_link_signal()) pb_adv_.transmit(false, std::move(*signal), now);
}

void Network::carry_of_robot(std::size_t index, TimePoint now) {
  Node& node = nodes_[index];
  Robot& robot = robots_[index];
  while (auto signal = node.next_link_signal()) pb_adv_.transmit(true, std::move(*signal), now);
  while (auto answer = node.next_answer()) {
    bool has_left = true;
    if (segment_count(answer->payload.size()) > 1) {
      const auto transmit = [&](TimePoint then) { return transmit_to_boards(*answer, then); };
      has_left = transmit_until_acknowledged(answer->ttl, now, transmit).has_value();
    } else {
      transmit_to_boards(*answer, now);
    }
    if (has_left) node.on_transmitted();
  }
  while (auto outgoing = robot.next_transmission()) {
    const bool is_on_its_way =
        node.prepare(outgoing->message) && transmit_to_boards(outgoing->message, now);
    if (is_on_its_way) node.on_transmitted();
    if (!is_on_its_way && outgoing->is_unacknowledged_update) robot.on_update_dropped();
    if (is_on_its_way) acknowledge_segments(index, outgoing->message, now);
  }
  while (auto heartbeat = node.next_heartbeat()) {
    carry_heartbeat(index, *heartbeat, now);
    node.on_transmitted();
  }
  robot.set_address(node.address());
}

/// Delivers heartbeats at once, each over the shortest path.
void Network::carry_heartbeat(std::size_t source, const Heartbeats::Heartbeat& heartbeat,
                              TimePoint now) {
  const std::vector<unsigned> hops = hops_from(source);
  for (std::size_t i = 0; i < nodes_.size(); ++i) {
    if (i == source || hops[i] == 0 || hops[i] > std::max<unsigned>(heartbeat.ttl, 1)) continue;
    bool is_lost = false;
    for (unsigned hop = 0; hop < hops[i]; ++hop) is_lost |= radio_.loses_beacon();
    if (is_lost) continue;
    nodes_[i].on_heartbeat(nodes_[source], heartbeat, static_cast<std::uint8_t>(hops[i]), now);
  }
}

/// Returns the hops to each robot; 0: no path. Robots stand in a row, hear others within their
/// reach, and relay if they are configured to.
std::vector<unsigned> Network::hops_from(std::size_t source) const {
  std::vector<unsigned> hops(nodes_.size(), 0);
  std::deque<std::size_t> found{source};
  while (!found.empty()) {
    const std::size_t next = found.front();
    found.pop_front();
    if (next != source && !nodes_[next].is_relay()) continue;
    for (std::size_t i = 0; i < nodes_.size(); ++i) {
      const std::size_t distance = std::max(i, next) - std::min(i, next);
      if (i == source || hops[i] != 0 || distance > options_.robot_reach) continue;
      hops[i] = hops[next] + 1;
      found.push_back(i);
    }
  }
  return hops;
}

bool Network::can_reach(const MeshMessage& message) const {
  return std::any_of(nodes_.begin(), nodes_.end(),
                     [&](const Node& node) { return node.acknowledges(message); });
}

/// The board acknowledges segments from the address that they were sent to. A robot that has heard
/// higher numbers from it, before the board forgot its own, discards the acknowledgement.
void Network::acknowledge_segments(std::size_t index, const MeshMessage& message, TimePoint now) {
  if (segment_count(message.payload.size()) == 1 || !is_unicast(message.destination)) return;
  for (Board& board : boards_) {
    const auto acknowledgement = board.acknowledge_segments(message);
    if (acknowledgement && nodes_[index].would_accept(message.destination, *acknowledgement))
      return;
  }
  robots_[index].on_unacknowledged_segments(message, now);
}

double Network::loss_of(std::size_t board, TimePoint now) const {
  const double fading = fading_of(value_of(options_.board_fade_s, board), now);
  return 1 - (1 - value_of(options_.board_loss, board)) * (1 - fading * fading);
}

std::vector<Receiver> Network::receivers(TimePoint now) const {
  std::vector<Receiver> all;
  for (std::size_t i = 0; i < boards_.size(); ++i) {
    const double fading = fading_of(value_of(options_.board_fade_s, i), now);
    const int level_db = value_of(options_.board_level_db, i) - static_cast<int>(fading * fade_db);
    all.push_back({boards_[i].local_address(), i, loss_of(i, now), level_db});
  }
  return all;
}

/// Returns true if the message reaches its board, or one of several.
bool Network::transmit_to_boards(const MeshMessage& message, TimePoint now) {
  const std::vector<bool> reached = radio_.transmit(message, receivers(now), now);
  bool is_for_one = false;
  for (std::size_t i = 0; i < boards_.size(); ++i) {
    if (!boards_[i].flash().is_local(message.destination)) continue;
    if (reached[i]) return true;
    is_for_one = true;
  }
  return !is_for_one && std::find(reached.begin(), reached.end(), true) != reached.end();
}

bool Network::transmit_to_robots(std::size_t board, const MeshMessage& message, TimePoint now) {
  return radio_.transmit(message, {{message.destination, {}, loss_of(board, now)}}, now).front();
}

/// Repeats segments to a group without acknowledgement.
void Network::begin_transfer(std::size_t board, const PacketSender::Transmission& transmission,
                             TimePoint now) {
  const MeshMessage& message = transmission.message;
  Duration duration = Radio::segment_time * static_cast<int>(segment_count(message.payload.size()));
  if (options_.has_segment_timing) duration = segmented_session(message.destination, message.ttl);
  bool is_acknowledged = true;
  if (!is_unicast(message.destination)) {
    transmit_to_robots(board, message, now);
  } else {
    std::optional<Duration> repeats;
    if (can_reach(message)) {
      repeats = transmit_until_acknowledged(message.ttl, now, [&](TimePoint then) {
        return transmit_to_robots(board, message, then);
      });
    }
    is_acknowledged = repeats.has_value();
    duration = repeats ? duration + *repeats : failed_session(message.ttl);
    const auto times =
        repeats ? *repeats / retry_interval(message.ttl) : segmented_transmissions - 1;
    boards_[board].repeat_segments(segment_count(message.payload.size()) *
                                   static_cast<std::size_t>(times));
  }
  transfers_.emplace(now + duration, Transfer{board, *transmission.transfer, is_acknowledged});
}

bool Network::has_sent_everything() const {
  return radio_.is_silent() && std::all_of(robots_.begin(), robots_.end(), [](const Robot& robot) {
           return robot.has_sent_everything();
         });
}

}  // namespace slamgw::sim::ble
