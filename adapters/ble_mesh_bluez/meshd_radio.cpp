// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_bluez/meshd_radio.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"
#include "daemon/core/parse_number.hpp"

namespace slamgw::ble {
namespace {

constexpr std::string_view not_found = "org.bluez.mesh.Error.NotFound";
constexpr std::string_view already_exists = "org.bluez.mesh.Error.AlreadyExists";
constexpr std::string_view access_denied = "org.freedesktop.DBus.Error.AccessDenied";
constexpr std::string_view no_such_object = "org.freedesktop.DBus.Error.NotFound";
constexpr std::string_view no_reply = "org.freedesktop.DBus.Error.NoReply";
constexpr const char* no_answer = "bluetooth-meshd does not answer; see slam-gatewayctl doctor";

constexpr std::int16_t rssi_not_available = 127;  // Core Specification, LE Advertising Report
constexpr std::string_view node_prefix = "bluez ";
constexpr std::size_t uuid_digits = 32;

std::string reason(const MeshdAnswer& answer) {
  if (answer.error == access_denied)
    return "the system bus denies the gateway access to bluetooth-meshd: " + answer.why;
  if (answer.error == no_reply) return no_answer;
  // The bus name is there before the controller is.
  if (answer.error == no_such_object)
    return "bluetooth-meshd waits for its Bluetooth controller; see slam-gatewayctl doctor";
  return fmt::format("a call to bluetooth-meshd failed: {} {}", answer.error, answer.why);
}

/// Makes a UUID of RFC 4122, version 4: meshd takes no other.
void make_uuid_valid(Uuid& uuid) {
  uuid[6] = static_cast<std::uint8_t>((uuid[6] & 0x0f) | 0x40);
  uuid[8] = static_cast<std::uint8_t>((uuid[8] & 0x3f) | 0x80);
}

}  // namespace

std::string encode_node(const MeshdNode& node) {
  std::string text = std::string(node_prefix) + to_hex(node.uuid);
  if (node.token) text += fmt::format(" {:016x}", *node.token);
  return text;
}

std::optional<MeshdNode> decode_node(std::string_view text) {
  if (!text.starts_with(node_prefix)) return std::nullopt;
  text.remove_prefix(node_prefix.size());
  const auto uuid = parse_uuid(text.substr(0, uuid_digits));
  if (!uuid) return std::nullopt;
  MeshdNode node{*uuid, {}};
  if (text.size() <= uuid_digits) return node;
  node.token = parse_number<std::uint64_t>(text.substr(uuid_digits + 1), 16);
  return node.token ? std::optional(node) : std::nullopt;
}

// --- meshd comes and goes ------------------------------------------------------------------------

void MeshdRadio::on_event(MeshdEvent& event, TimePoint now) {
  std::visit([&](auto& what) { on(what, now); }, event);
}

void MeshdRadio::on(const MeshdCame&, TimePoint now) {
  if (stage_ != Stage::absent)
    go_down("bluetooth-meshd has restarted");
  else if (!down_reason_.empty())
    go_down("bluetooth-meshd is back and prepares the gateway's node");
  begin(now);
}

void MeshdRadio::on(const MeshdGone& gone, TimePoint) {
  go_down(gone.why);
  stage_ = Stage::absent;
}

void MeshdRadio::on(const MeshdAnswer& answer, TimePoint now) {
  const auto found = calls_.find(answer.number);
  if (found == calls_.end()) return;  // the answer to a call at a former meshd
  const Done done = std::move(found->second);
  calls_.erase(found);
  done(answer, now);
}

void MeshdRadio::call(MeshdCall call, Done done) {
  calls_.emplace(++last_call_, std::move(done));
  requests_.push(CallMeshd{last_call_, std::move(call)});
}

void MeshdRadio::go_down(const std::string& why, bool is_restart) {
  if (stage_ == Stage::up || why != down_reason_) {
    LinkIsDown down{why, {}, is_restart};
    if (join_ && join_->due)
      down.join = JoinEnded{.failure = "the BLE link went down: " + why,
                            .may_have_joined = join_->has_address};
    actions_.push(std::move(down));
  }
  down_reason_ = why;
  forget();
}

/// Forgets all open requests: the next meshd, or the next node, does not know them.
void MeshdRadio::forget() {
  retry_at_.reset();
  calls_.clear();
  steps_.clear();
  copies_ = 0;
  step_due_.reset();
  waiting_.clear();
  answer_due_.reset();
  is_scan_wanted_ = false;
  rescan_at_.reset();
  join_.reset();
  if (std::exchange(is_clearing_, false))
    actions_.push(RadioCleared{"bluetooth-meshd has not answered"});
}

void MeshdRadio::pause(const std::string& why, Duration time, TimePoint now) {
  go_down(why);
  stage_ = Stage::pausing;
  retry_at_ = now + time;
}

// --- The gateway's node --------------------------------------------------------------------------

void MeshdRadio::begin(TimePoint now) {
  forget();
  if (!keys_) {
    stage_ = Stage::awaiting_keys;
    return actions_.push(KeysWanted{});
  }
  if (node_ && node_->token) return ask_for_source(max_sources);
  begin_node(now);
}

void MeshdRadio::on_keys_failed(const std::string& why, TimePoint now) {
  if (stage_ == Stage::awaiting_keys) pause(why, retry_after, now);
}

/// Makes another node. It has no sequence numbers yet, so it begins at an address that no robot has
/// heard.
void MeshdRadio::begin_node(TimePoint now) {
  node_ = MeshdNode{};
  own_device_key_ = Key{};
  if (!random_(node_->uuid) || !random_(*own_device_key_))
    return pause("no randomness for the keys of the gateway's node", retry_after, now);
  make_uuid_valid(node_->uuid);
  ask_for_source(0);
}

/// Asks for the node's address. The answer also means that the disk has the node.
void MeshdRadio::ask_for_source(std::uint16_t addresses) {
  stage_ = addresses == 0 ? Stage::awaiting_source : Stage::awaiting_disk;
  actions_.push(SourceWanted{encode_node(*node_), addresses});
}

void MeshdRadio::use_source(std::uint16_t source, std::uint16_t, TimePoint now) {
  source_ = source;
  if (stage_ == Stage::awaiting_source) return make_node(now);
  if (stage_ != Stage::awaiting_disk) return;
  if (own_device_key_) requests_.push(AcceptToken{});
  attach(now);
}

void MeshdRadio::make_node(TimePoint now) {
  stage_ = Stage::importing;
  step_due_ = now + node_time_limit;
  call(Import{node_->uuid, *own_device_key_, keys_->keys.net_key, keys_->iv_index, source_},
       [this](const MeshdAnswer& answer, TimePoint then) {
         if (!answer.is_success()) pause(reason(answer), retry_after, then);
       });
}

void MeshdRadio::on(const JoinComplete& complete, TimePoint) {
  if (stage_ != Stage::importing) return;
  step_due_.reset();
  node_->token = complete.token;
  ask_for_source(max_sources);
}

void MeshdRadio::attach(TimePoint now) {
  stage_ = Stage::attaching;
  step_due_ = now + node_time_limit;
  call(Attach{*node_->token},
       [this](const MeshdAnswer& answer, TimePoint then) { on_attached(answer, then); });
}

void MeshdRadio::on_attached(const MeshdAnswer& answer, TimePoint now) {
  if (answer.error == not_found) {
    if (own_device_key_) {
      node_.reset();
      return refuse_node("does not know the gateway's new node", now);
    }
    actions_.push(Notice{Severity::warning,
                         "bluetooth-meshd has lost the gateway's node: the gateway creates a new "
                         "one at another address",
                         {}});
    return begin_node(now);
  }
  if (answer.error == already_exists) {  // attached since before a pause
    requests_.push(Reconnect{});
    return on(MeshdGone{reason(answer)}, now);
  }
  if (!answer.is_success()) return pause(reason(answer), retry_after, now);
  stage_ = Stage::preparing;
  call(GetAddresses{}, [this](const MeshdAnswer& property, TimePoint then) {
    if (!property.is_success()) return pause(reason(property), retry_after, then);
    if (property.address != source_) {
      if (own_device_key_) return refuse_node("gives the gateway's new node another address", then);
      return leave("the gateway has another address now");
    }
    plan();
    do_step(then);
  });
}

/// A meshd that does not serve the node that it has just made would not serve the next one either,
/// and each one costs disk writes. So the gateway waits.
void MeshdRadio::refuse_node(const std::string& what, TimePoint now) {
  pause("bluetooth-meshd " + what, 10 * retry_after, now);
}

void MeshdRadio::leave(const std::string& why, bool is_restart) {
  go_down(why, is_restart);
  stage_ = Stage::leaving;
  call(Leave{*node_->token}, [this](const MeshdAnswer& answer, TimePoint now) {
    const bool is_gone = answer.is_success() || answer.error == not_found;
    if (std::exchange(is_clearing_, false))
      actions_.push(RadioCleared{is_gone ? "" : reason(answer)});
    if (!is_gone) return pause(reason(answer), retry_after, now);
    begin_node(now);
  });
}

void MeshdRadio::clear(TimePoint) {
  if (stage_ == Stage::absent || !node_ || !node_->token) {
    actions_.push(RadioCleared{"the BLE link is down"});
    return;
  }
  leave("an operator has ordered a new node for the gateway");
  is_clearing_ = true;
}

bool MeshdRadio::restart(TimePoint) {
  if (stage_ != Stage::up) return false;
  leave("the gateway makes a new node, to hear all robots", /*is_restart=*/true);
  return true;
}

/// No call replaces a key in meshd's database. So the gateway makes a new node when its sending
/// keys change.
void MeshdRadio::change_keys(const RadioKeys& keys, TimePoint now) {
  const bool sends_as_before = keys_ && keys_->keys == keys.keys;
  keys_ = keys;
  if (stage_ == Stage::awaiting_keys) return begin(now);
  if (stage_ == Stage::absent || stage_ == Stage::leaving) return;
  if (!sends_as_before) {
    if (node_ && node_->token) return leave("the mesh has new keys");
    go_down("the mesh has new keys");
    return begin(now);
  }
  const bool is_busy = !steps_.empty();
  if (stage_ != Stage::up && !is_busy) return;  // plan() will include the new keys
  plan_refresh();
  if (!is_busy && !steps_.empty()) do_step(now);
}

// --- Preparing the node --------------------------------------------------------------------------

/// meshd takes configuration messages to its own node under the node's device key, as for any node.
void MeshdRadio::configure(const Exchange& exchange, const auto&... params) {
  steps_.push_back({DevKeySend{source_, encode_access(exchange.request, octets_of(params...))},
                    exchange.answer, exchange.has_status});
}

void MeshdRadio::plan() {
  steps_ = {{ImportSubnet{keys_->keys.net_key}}, {ImportAppKey{keys_->keys.app_key}}};
  if (own_device_key_) steps_.push_back({ImportRemoteNode{source_, *own_device_key_}});
  const Bytes model = encode_model_id(gateway_model);
  configure(appkey_add, key_indexes_0, keys_->keys.app_key);
  configure(model_app_bind, source_, key_index_0, model);
  configure(default_ttl_set, settings_.ttl);
  configure(network_transmit_set, encode_transmissions(transmissions));
  configure(model_subscription_delete_all, source_, model);
  for (const std::uint16_t group : settings_.heard_groups())
    configure(model_subscription_add, source_, group, model);
  plan_refresh();
}

/// Lets the node hear both pairs of keys and send under the old ones. The node refuses a step that
/// it has done already, such as after a beacon of a robot that is ahead.
void MeshdRadio::plan_refresh() {
  if (!keys_->next) return;
  const auto unchecked = [](Exchange exchange) {
    exchange.has_status = false;
    return exchange;
  };
  configure(unchecked(netkey_update), key_index_0, keys_->next->net_key);
  configure(unchecked(appkey_update), key_indexes_0, keys_->next->app_key);
}

void MeshdRadio::do_step(TimePoint now) {
  ++copies_;
  step_due_ = now + (steps_.front().answer != 0 ? step_time_limit : node_time_limit);
  call(steps_.front().call,
       [this](const MeshdAnswer& answer, TimePoint then) { on_step_answer(answer, then); });
}

void MeshdRadio::on_step_answer(const MeshdAnswer& answer, TimePoint now) {
  if (steps_.empty()) return;
  if (answer.error == already_exists) {
    if (own_device_key_) return refuse_node("has other keys for the gateway's new node", now);
    return leave("bluetooth-meshd has other keys");
  }
  if (!answer.is_success()) return pause(reason(answer), retry_after, now);
  if (steps_.front().answer == 0) end_step(now);
}

void MeshdRadio::on_configured(const AccessMessage& answer, TimePoint now) {
  if (steps_.empty() || steps_.front().answer != answer.opcode) return;
  const std::uint8_t status = answer.params.empty() ? 0 : answer.params.front();
  if (steps_.front().has_status && status != 0)
    return pause(fmt::format("bluetooth-meshd's node refuses its configuration: {}",
                             config_status_text(status)),
                 retry_after, now);
  end_step(now);
}

void MeshdRadio::end_step(TimePoint now) {
  steps_.pop_front();
  copies_ = 0;
  step_due_.reset();
  if (!steps_.empty()) return do_step(now);
  if (stage_ == Stage::preparing) come_up(now);
}

void MeshdRadio::come_up(TimePoint now) {
  stage_ = Stage::up;
  down_reason_.clear();
  const bool has_kept_address = !std::exchange(own_device_key_, std::nullopt);
  air_free_at_ = now;
  ask_iv_at_ = now;
  actions_.push(LinkIsUp{"bluetooth-meshd", encode_node(*node_), source_, has_kept_address});
}

void MeshdRadio::ask_iv_index(TimePoint now) {
  ask_iv_at_ = now + iv_index_interval;
  answer_due_ = now + answer_time_limit;
  call(GetIvIndex{}, [this](const MeshdAnswer& answer, TimePoint then) {
    answer_due_.reset();
    if (!answer.is_success()) return pause(reason(answer), retry_after, then);
    if (std::exchange(keys_->iv_index, answer.iv_index) != answer.iv_index)
      actions_.push(IvUpdate{answer.iv_index});
  });
}

// --- Messages ------------------------------------------------------------------------------------

void MeshdRadio::send(Outgoing message, TimePoint) {
  if (stage_ != Stage::up) return;
  const auto is_same = [&](const Outgoing& other) {
    return other.destination == message.destination && other.payload == message.payload;
  };
  if (std::ranges::any_of(waiting_, is_same)) return;
  if (waiting_.size() >= max_waiting) return void(++dropped_);
  const auto behind_urgent = std::ranges::find(waiting_, false, &Outgoing::is_urgent);
  waiting_.insert(message.is_urgent ? behind_urgent : waiting_.end(), std::move(message));
}

void MeshdRadio::withdraw(std::uint16_t destination, const Bytes& payload) {
  std::erase_if(waiting_, [&](const Outgoing& each) {
    return each.destination == destination && each.payload == payload;
  });
}

/// meshd answers at once and queues without a bound. So a message waits here until the previous one
/// has left the air, and an urgent message can overtake it.
void MeshdRadio::send_next(TimePoint now) {
  if (stage_ != Stage::up || answer_due_ || waiting_.empty() || now < air_free_at_) return;
  Outgoing next = std::move(waiting_.front());
  waiting_.pop_front();
  answer_due_ = now + answer_time_limit;
  air_free_at_ = now + packet_time * segments_of(next.payload.size());
  const auto sent = [this, destination = next.destination](const MeshdAnswer& answer, TimePoint) {
    answer_due_.reset();
    if (answer.is_success()) return;
    ++refused_;
    actions_.push(SendRefused{destination, reason(answer)});
  };
  if (next.is_under_device_key)
    return call(DevKeySend{next.destination, std::move(next.payload)}, sent);
  call(Send{next.destination, next.key.value_or(0), std::move(next.payload)}, sent);
}

void MeshdRadio::on(AppMessage& message, TimePoint) {
  // meshd also delivers the gateway's own messages to a group.
  if (stage_ != Stage::up || message.source == source_) return;
  const auto length = static_cast<std::uint16_t>(message.payload.size());
  actions_.push(MessageReceived{
      message.source, message.key, false, {}, {}, length, std::move(message.payload)});
}

void MeshdRadio::on(DevKeyMessage& message, TimePoint now) {
  if (message.source == source_) {
    const auto answer = decode_access(message.payload);
    if (answer.has_value()) on_configured(*answer, now);
    return;
  }
  if (stage_ != Stage::up || !message.is_remote) return;
  const auto length = static_cast<std::uint16_t>(message.payload.size());
  actions_.push(
      MessageReceived{message.source, 0, true, {}, {}, length, std::move(message.payload)});
}

void MeshdRadio::use_device_key(std::uint16_t address, const std::optional<Key>& key) {
  if (!key) return actions_.push(DeviceKeyUsed{address, {}});  // meshd has it since the node joined
  call(ImportRemoteNode{address, *key}, [this, address](const MeshdAnswer& answer, TimePoint) {
    actions_.push(DeviceKeyUsed{address, answer.is_success() ? "" : reason(answer)});
  });
}

// --- Joining -------------------------------------------------------------------------------------

void MeshdRadio::run_scan(TimePoint now) {
  const bool may_scan = is_scan_wanted_ && !join_;
  if (!may_scan && rescan_at_) {
    rescan_at_.reset();
    if (!join_) call(UnprovisionedScanCancel{}, [](const MeshdAnswer&, TimePoint) {});
  }
  if (!may_scan || (rescan_at_ && now < *rescan_at_)) return;
  rescan_at_ = now + rescan_after;
  call(UnprovisionedScan{}, [](const MeshdAnswer&, TimePoint) {});
}

void MeshdRadio::on(const ScanResult& result, TimePoint) {
  UnprovisionedBeacon beacon;
  if (!rescan_at_ || result.data.size() < beacon.uuid.size()) return;
  std::copy_n(result.data.begin(), beacon.uuid.size(), beacon.uuid.begin());
  if (result.rssi != rssi_not_available) beacon.rssi_dbm = static_cast<std::int8_t>(result.rssi);
  actions_.push(beacon);
}

void MeshdRadio::begin_join(TimePoint now) {
  join_->due = now + join_time_limit;
  call(AddNode{join_->device.uuid}, [this](const MeshdAnswer& answer, TimePoint) {
    if (join_ && !answer.is_success()) end_join({.failure = reason(answer)});
  });
}

void MeshdRadio::on(const StaticOobGiven&, TimePoint) {
  if (join_ && join_->due) join_->has_static_oob = true;
}

void MeshdRadio::on(const RequestProvData& wanted, TimePoint now) {
  if (!join_ || !join_->due) return requests_.push(GiveAddress{});
  if (join_->device.static_oob && !join_->has_static_oob)
    return answer_device(lacks_static_oob, now);
  actions_.push(DeviceAnswered{wanted.elements});
}

void MeshdRadio::answer_device(const std::string& refusal, TimePoint) {
  if (!join_) return;
  join_->refusal = refusal;
  join_->has_address = refusal.empty();
  GiveAddress answer;
  if (join_->has_address) answer.address = join_->device.address;
  requests_.push(answer);
}

void MeshdRadio::on(const AddNodeComplete& added, TimePoint) {
  if (!join_ || join_->device.uuid != added.uuid) return;
  join_->has_joined = true;
  call(ExportKeys{},
       [this, uuid = added.uuid, address = added.address](const MeshdAnswer& answer, TimePoint) {
         if (!join_ || join_->device.uuid != uuid) return;  // given up since
         const auto key = answer.device_keys.find(address);
         DeviceJoined joined;
         if (key != answer.device_keys.end()) joined.device_key = key->second;
         actions_.push(joined);
         end_join({});
       });
}

void MeshdRadio::on(const AddNodeFailed& failed, TimePoint) {
  if (!join_ || join_->device.uuid != failed.uuid || join_->has_joined) return;
  if (!join_->refusal.empty()) return end_join({.failure = join_->refusal});
  end_join(
      {.failure = "bluetooth-meshd gave up: " + failed.why, .may_have_joined = join_->has_address});
}

void MeshdRadio::end_join(JoinEnded ended) {
  join_.reset();
  actions_.push(std::move(ended));
}

// --- Time ----------------------------------------------------------------------------------------

std::optional<RadioAction> MeshdRadio::next_action(TimePoint now) {
  if (auto action = actions_.pop()) return action;
  if (stage_ == Stage::up) {
    if (join_ && !join_->due) begin_join(now);
    run_scan(now);
    send_next(now);
  }
  return actions_.pop();
}

std::optional<TimePoint> MeshdRadio::deadline() const {
  std::optional<TimePoint> next = earlier(retry_at_, step_due_);
  if (stage_ != Stage::up) return next;
  next = earlier(next, answer_due_.value_or(ask_iv_at_));
  next = earlier(next, rescan_at_);
  if (join_) next = earlier(next, join_->due);
  if (!waiting_.empty() && !answer_due_) next = earlier(next, air_free_at_);
  return next;
}

void MeshdRadio::on_deadline(TimePoint now) {
  if (retry_at_ && now >= *retry_at_) return begin(now);
  if (step_due_ && now >= *step_due_) {
    const bool awaits_meshd = steps_.empty() || steps_.front().answer == 0;
    if (awaits_meshd) return pause(no_answer, retry_after, now);
    if (copies_ < max_copies) return do_step(now);
    // After a power cut meshd may send with lower sequence numbers than its own node remembers.
    if (!own_device_key_)
      return leave(
          "bluetooth-meshd's node does not take its configuration: the gateway makes another one");
    return refuse_node("does not configure the gateway's new node", now);
  }
  if (stage_ != Stage::up) return;
  if (answer_due_ && now >= *answer_due_) return pause(no_answer, retry_after, now);
  if (join_ && join_->due && now >= *join_->due)
    end_join({.failure = "bluetooth-meshd reported no result for the join",
              .may_have_joined = join_->has_address});
  if (now >= ask_iv_at_ && !answer_due_) ask_iv_index(now);
}

}  // namespace slamgw::ble
