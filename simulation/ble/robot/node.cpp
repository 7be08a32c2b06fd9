// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/robot/node.hpp"

#include <algorithm>

namespace slamgw::sim::ble {
namespace {

constexpr std::uint8_t health_current_status = 0x04;

/// Returns the model that publishes this message.
std::optional<ModelId> publisher_of(ByteView message) {
  if (!message.empty() && message[0] == health_current_status) return health_server;
  const std::optional<Vendor> opcode = vendor_opcode(message);
  if (!opcode) return std::nullopt;
  if (*opcode == Vendor::min_com_set || *opcode == Vendor::min_com_set_unreliable) {
    return min_com_client;
  }
  return sensor_update_client;
}

/// Returns the model that understands this message.
std::optional<ModelId> receiver_of(ByteView message) {
  if (const auto opcode = two_octet_opcode(message)) {
    const bool is_on_off = *opcode >= on_off_get && *opcode <= on_off_set_unacknowledged;
    return is_on_off ? std::optional(generic_on_off_server) : std::nullopt;
  }
  const std::optional<Vendor> opcode = vendor_opcode(message);
  if (!opcode) return std::nullopt;
  switch (*opcode) {
    case Vendor::simple_on_off_set:
    case Vendor::simple_on_off_get:
    case Vendor::simple_on_off_set_unreliable: return simple_on_off_server;
    case Vendor::min_com_set:
    case Vendor::min_com_get:
    case Vendor::min_com_set_unreliable: return min_com_server;
    case Vendor::min_com_status: return min_com_client;
    case Vendor::sensor_update_status:
    case Vendor::sensor_update_relayed: return sensor_update_client;
    case Vendor::pos_cmd_set:
    case Vendor::pos_cmd_get:
    case Vendor::pos_cmd_set_unreliable: return pos_cmd_server;
    case Vendor::pos_cmd_status: return pos_cmd_client;
    case Vendor::simple_on_off_status:
    case Vendor::sensor_update_set:
    case Vendor::sensor_update_get:
    case Vendor::sensor_update_set_unreliable:
    case Vendor::min_com_set_numbered:
    case Vendor::sensor_update_set_numbered: return std::nullopt;
  }
  return std::nullopt;
}

}  // namespace

Node::Node(const Settings& settings, Random random)
    : settings_(settings),
      random_(random),
      key_pair_(make_key_pair(random_)),
      heartbeats_(*settings.firmware) {}

void Node::restore(NodeConfiguration configuration, std::uint32_t next_sequence) {
  configuration_ = std::move(configuration);
  next_sequence_ = next_sequence;
}

void Node::on_start(TimePoint now) {
  if (address() != 0) return;
  next_beacon_ = now + std::chrono::milliseconds{37 * settings_.number % 1000};
}

Address Node::address() const {
  if (settings_.fixed_address) return *settings_.fixed_address;
  return configuration_.network ? configuration_.network->address : Address{0};
}

std::optional<TimePoint> Node::deadline() const {
  if (is_gone()) return std::nullopt;
  return first_of(first_of(next_beacon_, link_ends_), heartbeats_.deadline());
}

void Node::on_deadline(TimePoint now) {
  if (link_ends_ && *link_ends_ <= now) end_link();
  heartbeats_.on_deadline(now);
  if (!next_beacon_ || *next_beacon_ > now) return;
  next_beacon_ = now + beacon_interval;
  is_beacon_due_ = !link_;
}

std::optional<Key> Node::next_beacon() {
  if (!is_beacon_due_) return std::nullopt;
  is_beacon_due_ = false;
  return settings_.uuid;
}

bool Node::takes(const LinkSignal& signal) const {
  if (is_gone()) return false;
  if (signal.kind != LinkSignal::Kind::open) return link_ == signal.link;
  return signal.uuid == settings_.uuid && address() == 0 && !link_;
}

void Node::on_link_signal(const LinkSignal& signal, TimePoint now) {
  link_ends_ = now + link_time;
  switch (signal.kind) {
    case LinkSignal::Kind::open:
      link_ = signal.link;
      provisionee_.emplace(Provisionee::Identity{key_pair_, settings_.static_oob},
                           random_key(random_));
      signals_.push_back({LinkSignal::Kind::opened, signal.link, {}, {}});
      return;
    case LinkSignal::Kind::pdu: return answer_link(signal.pdu, now);
    case LinkSignal::Kind::close: return end_link();
    case LinkSignal::Kind::opened: return;  // only devices send this
  }
}

void Node::answer_link(ByteView pdu, TimePoint now) {
  if (std::optional<Bytes> answer = provisionee_->on_pdu(pdu)) {
    signals_.push_back({LinkSignal::Kind::pdu, *link_, {}, std::move(*answer)});
  }
  const std::optional<Provisionee::Result>& result = provisionee_->result();
  if (!result || configuration_.network) return;
  configuration_.join(result->data, result->device_key);
  configured_at_ = now;
  next_beacon_.reset();
}

void Node::end_link() {
  link_.reset();
  link_ends_.reset();
  provisionee_.reset();
}

std::optional<LinkSignal> Node::next_link_signal() {
  if (signals_.empty()) return std::nullopt;
  LinkSignal signal = std::move(signals_.front());
  signals_.pop_front();
  return signal;
}

bool Node::is_for_us(Address destination) const {
  if (is_unicast(destination)) return destination == address();
  if (destination == all_nodes) return true;
  if (settings_.fixed_address && destination == relay_group) return true;
  return std::any_of(configuration_.models.begin(), configuration_.models.end(),
                     [&](const Model& model) {
                       const auto& groups = model.subscriptions;
                       return std::find(groups.begin(), groups.end(), destination) != groups.end();
                     });
}

bool Node::reaches(const MeshMessage& message) const {
  if (is_gone() || address() == 0 || !is_for_us(message.destination)) return false;
  if (settings_.fixed_address) return true;
  return message.encryption && configuration_.has_net_key(message.encryption->net_key);
}

bool Node::acknowledges(const MeshMessage& message) const {
  return reaches(message) && heard_.would_accept(message.source, message.sequence);
}

const AppKey* Node::find_app_key(const Key& key) const {
  const auto found =
      std::find_if(configuration_.app_keys.begin(), configuration_.app_keys.end(),
                   [&](const AppKey& k) { return k.key == key || k.new_key == key; });
  return found == configuration_.app_keys.end() ? nullptr : &*found;
}

bool Node::on_message(const MeshMessage& message, TimePoint now) {
  if (!reaches(message)) return false;
  const bool is_device_key = message.encryption && message.encryption->is_device_key;
  if (settings_.fixed_address) {
    return !is_device_key && heard_.accept(message.source, message.sequence);
  }
  if (is_device_key) {
    const bool is_ours =
        message.encryption->key == configuration_.device_key && message.destination == address();
    if (is_ours && heard_.accept(message.source, message.sequence)) configure(message, now);
    return false;
  }
  const AppKey* key = find_app_key(message.encryption->key);
  if (key == nullptr || !heard_.accept(message.source, message.sequence)) return false;
  return is_taken_by_model(message, key->index);
}

bool Node::is_taken_by_model(const MeshMessage& message, std::uint16_t app_key_index) const {
  const std::optional<ModelId> id = receiver_of(message.payload);
  const Model* model = id ? configuration_.find_model(*id) : nullptr;
  if (model == nullptr) return false;
  const auto& bindings = model->bindings;
  const auto& groups = model->subscriptions;
  const bool is_bound =
      std::find(bindings.begin(), bindings.end(), app_key_index) != bindings.end();
  const bool is_addressed =
      message.destination == address() ||
      std::find(groups.begin(), groups.end(), message.destination) != groups.end();
  return is_bound && is_addressed;
}

void Node::configure(const MeshMessage& request, TimePoint now) {
  const std::uint16_t net_index = configuration_.network_of(request.encryption->net_key)->index;
  const auto of_heartbeats = heartbeats_.on_message(request.payload, configuration_, now);
  const ConfigServer::Result result =
      of_heartbeats ? ConfigServer::Result{*of_heartbeats, false, heartbeats_.failed_assertion()}
                    : ConfigServer(*settings_.firmware, configuration_).on_message(request.payload);
  failed_assertion_ = result.failed_assertion;
  if (!result.answer) return;
  if (!of_heartbeats) configured_at_ = now;
  Encryption encryption = *request.encryption;
  encryption.net_key = configuration_.sending_key(*configuration_.find_net_key(net_index));
  MeshMessage answer{address(), request.source, configuration_.ttl, *result.answer, 0, encryption};
  prepare(answer);
  answers_.push_back(std::move(answer));
  if (result.resets_node) reset(now);
}

/// Makes the node an unprovisioned device (Mesh Profile 1.0 section 4.3.2.53). Its sequence numbers
/// continue, as it may get the same address again.
void Node::reset(TimePoint now) {
  configuration_ = NodeConfiguration();
  heartbeats_.reset();
  heard_.clear();
  configured_at_.reset();
  next_beacon_ = now + beacon_interval;
}

void Node::power_cycle() {
  heard_.clear();
  heartbeats_.reset();
  end_link();
  answers_.clear();
}

void Node::reset_by_hand(TimePoint now) {
  power_cycle();
  reset(now);
  next_sequence_ = 0;
}

std::optional<MeshMessage> Node::next_answer() {
  if (answers_.empty()) return std::nullopt;
  MeshMessage answer = std::move(answers_.front());
  answers_.pop_front();
  return answer;
}

bool Node::prepare(MeshMessage& message) {
  if (is_gone() || address() == 0) return false;
  if (!settings_.fixed_address && !message.encryption) {
    const std::optional<ModelId> id = publisher_of(message.payload);
    const Model* model = id ? configuration_.find_model(*id) : nullptr;
    const AppKey* key = model == nullptr ? nullptr : publishing_key(*model);
    if (key == nullptr) return false;
    const NetKey* net_key = configuration_.find_net_key(key->net_index);
    message.encryption =
        Encryption{configuration_.sending_key(*net_key), configuration_.sending_key(*key), false};
  }
  const std::size_t octets = message.payload.size();
  message.source = address();
  message.sequence = next_sequence_;
  next_sequence_ += sequence_numbers(message.destination, octets, segment_count(octets) > 1);
  return true;
}

std::optional<Heartbeats::Heartbeat> Node::next_heartbeat() {
  auto heartbeat = heartbeats_.next();
  if (heartbeat) ++next_sequence_;
  return is_gone() ? std::nullopt : heartbeat;
}

/// Under the first network key. The source takes a place in the replay list.
void Node::on_heartbeat(const Node& source, const Heartbeats::Heartbeat& heartbeat,
                        std::uint8_t hops, TimePoint now) {
  const auto key = source.net_key();
  if (is_gone() || !key || !configuration_.has_net_key(*key)) return;
  if (!heartbeats_.hears(heartbeat.destination, configuration_)) return;
  if (!heard_.accept(source.address(), source.next_sequence_ - 1)) return;
  heartbeats_.on_heartbeat(source.address(), heartbeat.destination, hops, now);
}

/// A model publishes with a key that it is bound to (Mesh Profile 1.0 section 4.2.2.3).
const AppKey* Node::publishing_key(const Model& model) const {
  const std::uint16_t index = model.publication.app_key_index;
  const auto& bindings = model.bindings;
  if (std::find(bindings.begin(), bindings.end(), index) == bindings.end()) return nullptr;
  return configuration_.find_app_key(index);
}

std::optional<Robot::Publication> Node::publication_of(ModelId id) const {
  const Model* model = configuration_.find_model(id);
  if (model == nullptr || model->publication.address == 0) return std::nullopt;
  if (publishing_key(*model) == nullptr) return std::nullopt;
  const ModelPublication& publication = model->publication;
  const std::uint8_t ttl =
      publication.ttl == use_default_ttl ? configuration_.ttl : publication.ttl;
  return Robot::Publication{publication.address, ttl, publish_period(publication.period)};
}

std::optional<Key> Node::net_key() const {
  if (configuration_.net_keys.empty()) return std::nullopt;
  return configuration_.sending_key(configuration_.net_keys.front());
}

Robot::Publications Node::publications(TimePoint now) const {
  if (configured_at_ && now - *configured_at_ < settling_time) return {};
  return {publication_of(min_com_client), publication_of(sensor_update_client),
          publication_of(health_server)};
}

}  // namespace slamgw::sim::ble
