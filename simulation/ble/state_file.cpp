// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/state_file.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <system_error>

namespace slamgw::sim::ble {
namespace {

using nlohmann::json;

constexpr std::uint32_t saved_sequence_block = 8192;

std::string to_hex(const Key& key) { return fmt::format("{:02x}", fmt::join(key, "")); }

Key key_from(const json& from) {
  const std::string text = from.get<std::string>();
  Key key{};
  const bool is_hex = text.size() == 2 * key.size() &&
                      text.find_first_not_of("0123456789abcdef") == std::string::npos;
  if (!is_hex) throw std::runtime_error("a key is not 32 hex digits");
  for (std::size_t i = 0; i < key.size(); ++i) {
    key[i] = static_cast<std::uint8_t>(std::stoul(text.substr(2 * i, 2), nullptr, 16));
  }
  return key;
}

KeyTable::Slot key_slot(const json& from) {
  KeyTable::Slot slot{from.at("index").get<std::uint16_t>(), from.at("subnet").get<Handle>(),
                      key_from(from.at("key"))};
  if (from.contains("new_key")) slot.new_key = key_from(from.at("new_key"));
  return slot;
}

json to_json(const KeyTable& table) {
  json out = json::array();
  for (const Handle handle : table.handles()) {
    const KeyTable::Slot* slot = table.find(handle);
    out.push_back({{"handle", handle},
                   {"index", slot->index},
                   {"subnet", slot->subnet},
                   {"key", to_hex(slot->key)}});
    if (slot->new_key) out.back()["new_key"] = to_hex(*slot->new_key);
  }
  return out;
}

void restore(KeyTable& table, const json& from) {
  for (const json& slot : from) {
    if (!table.restore(slot.at("handle").get<Handle>(), key_slot(slot))) {
      throw std::runtime_error("a key handle is out of range");
    }
  }
}

json to_json(const AddressTable& table) {
  json out = json::array();
  for (const Handle handle : table.handles()) {
    const AddressTable::Slot* slot = table.find(handle);
    out.push_back({{"handle", handle},
                   {"address", slot->address},
                   {"subscriptions", slot->subscriptions},
                   {"publications", slot->publications}});
    if (slot->label) out.back()["label"] = to_hex(*slot->label);
  }
  return out;
}

void restore(AddressTable& table, const json& from) {
  for (const json& slot : from) {
    AddressTable::Slot restored{slot.at("address").get<Address>()};
    restored.subscriptions = slot.at("subscriptions").get<std::uint16_t>();
    restored.publications = slot.at("publications").get<std::uint16_t>();
    if (slot.contains("label")) restored.label = key_from(slot.at("label"));
    if (!table.restore(slot.at("handle").get<Handle>(), restored)) {
      throw std::runtime_error("an address handle is out of range");
    }
  }
}

json to_json(const BoardFlash& flash) {
  return {{"start", flash.local_start},           {"count", flash.local_count},
          {"sequence", flash.reserved_sequence},  {"subnets", to_json(flash.subnets)},
          {"appkeys", to_json(flash.appkeys)},    {"devkeys", to_json(flash.devkeys)},
          {"addresses", to_json(flash.addresses)}};
}

BoardFlash flash_from(const json& from) {
  BoardFlash flash;
  flash.local_start = from.at("start").get<Address>();
  flash.local_count = from.at("count").get<std::uint16_t>();
  flash.reserved_sequence = from.at("sequence").get<std::uint32_t>();
  restore(flash.subnets, from.at("subnets"));
  restore(flash.appkeys, from.at("appkeys"));
  restore(flash.devkeys, from.at("devkeys"));
  restore(flash.addresses, from.at("addresses"));
  for (const Handle handle : flash.appkeys.handles()) {
    if (flash.subnets.find(flash.appkeys.find(handle)->subnet) == nullptr) {
      throw std::runtime_error("an application key is of no subnet");
    }
  }
  return flash;
}

json to_json(const Model& model) {
  const ModelPublication& to = model.publication;
  return {{"company", model.id.company},
          {"id", model.id.id},
          {"bindings", model.bindings},
          {"subscriptions", model.subscriptions},
          {"publication",
           {to.address, to.app_key_index, to.has_friendship_credential ? 1 : 0, to.ttl, to.period,
            to.retransmit}}};
}

void restore(NodeConfiguration& configuration, const json& from) {
  Model* model = configuration.find_model(
      {from.at("company").get<std::uint16_t>(), from.at("id").get<std::uint16_t>()});
  if (model == nullptr) throw std::runtime_error("an unknown model");
  model->bindings = from.at("bindings").get<std::vector<std::uint16_t>>();
  model->subscriptions = from.at("subscriptions").get<std::vector<Address>>();
  const json& to = from.at("publication");
  model->publication = {to.at(0).get<Address>(),      to.at(1).get<std::uint16_t>(),
                        to.at(2).get<int>() != 0,     to.at(3).get<std::uint8_t>(),
                        to.at(4).get<std::uint8_t>(), to.at(5).get<std::uint8_t>()};
}

json to_json(const NetKey& key) {
  json out{{"index", key.index}, {"key", to_hex(key.key)}, {"phase", key.phase}};
  if (key.new_key) out["new_key"] = to_hex(*key.new_key);
  return out;
}

NetKey net_key_from(const json& from) {
  NetKey key{from.at("index").get<std::uint16_t>(), key_from(from.at("key"))};
  key.phase = from.at("phase").get<KeyRefreshPhase>();
  if (from.contains("new_key")) key.new_key = key_from(from.at("new_key"));
  return key;
}

json to_json(const AppKey& key) {
  json out{{"index", key.index}, {"key", to_hex(key.key)}, {"net_index", key.net_index}};
  if (key.new_key) out["new_key"] = to_hex(*key.new_key);
  return out;
}

AppKey app_key_from(const json& from, const NodeConfiguration& configuration) {
  AppKey key{from.at("index").get<std::uint16_t>(), key_from(from.at("key"))};
  key.net_index = configuration.network->net_key_index;
  if (from.contains("net_index")) key.net_index = from.at("net_index").get<std::uint16_t>();
  if (from.contains("new_key")) key.new_key = key_from(from.at("new_key"));
  if (configuration.find_net_key(key.net_index) == nullptr) {
    throw std::runtime_error("an application key is of no network");
  }
  return key;
}

json to_json(const Node& node) {
  const NodeConfiguration& configuration = node.configuration();
  const std::uint32_t blocks =
      (node.next_sequence() + saved_sequence_block / 2) / saved_sequence_block + 1;
  json out{{"number", node.number()}, {"sequence", blocks * saved_sequence_block}};
  if (!configuration.network) return out;
  const ProvisioningData& network = *configuration.network;
  out["net_key"] = to_hex(network.net_key);
  out["net_key_index"] = network.net_key_index;
  out["flags"] = network.flags;
  out["iv_index"] = network.iv_index;
  out["address"] = network.address;
  out["device_key"] = to_hex(configuration.device_key);
  for (const NetKey& key : configuration.net_keys) out["net_keys"].push_back(to_json(key));
  out["app_keys"] = json::array();
  for (const AppKey& key : configuration.app_keys) out["app_keys"].push_back(to_json(key));
  for (const Model& model : configuration.models) out["models"].push_back(to_json(model));
  out["features"] = {configuration.ttl, configuration.relay, configuration.relay_retransmit,
                     configuration.secure_network_beacon, configuration.network_transmit};
  return out;
}

/// Files of earlier versions have neither `net_keys` nor `features`.
NodeConfiguration configuration_from(const json& from) {
  NodeConfiguration configuration;
  if (!from.contains("net_key")) return configuration;
  configuration.join({key_from(from.at("net_key")), from.at("net_key_index").get<std::uint16_t>(),
                      from.at("flags").get<std::uint8_t>(),
                      from.at("iv_index").get<std::uint32_t>(), from.at("address").get<Address>()},
                     key_from(from.at("device_key")));
  if (from.contains("net_keys")) {
    configuration.net_keys.clear();
    for (const json& key : from.at("net_keys")) configuration.net_keys.push_back(net_key_from(key));
  }
  for (const json& key : from.at("app_keys")) {
    configuration.app_keys.push_back(app_key_from(key, configuration));
  }
  for (const json& model : from.at("models")) restore(configuration, model);
  if (from.contains("features")) {
    const json& features = from.at("features");
    configuration.ttl = features.at(0).get<std::uint8_t>();
    configuration.relay = features.at(1).get<std::uint8_t>();
    configuration.relay_retransmit = features.at(2).get<std::uint8_t>();
    configuration.secure_network_beacon = features.at(3).get<std::uint8_t>();
    configuration.network_transmit = features.at(4).get<std::uint8_t>();
  }
  return configuration;
}

[[noreturn]] void throw_errno(const std::string& what) {
  throw std::system_error(errno, std::generic_category(), what);
}

}  // namespace

std::string state_of(const Network& network) {
  json out{{"nodes", json::array()}};
  if (network.board().has_storage()) out["board"] = to_json(network.board().flash());
  for (const Node& node : network.nodes()) out["nodes"].push_back(to_json(node));
  return out.dump(1) + "\n";
}

void restore_state(Network& network, const std::string& text) {
  try {
    const json from = json::parse(text);
    const bool has_board = network.board().has_storage() && from.contains("board");
    if (has_board) network.restore_board(flash_from(from.at("board")));
    for (const json& node : from.at("nodes")) {
      network.restore_node(node.at("number").get<unsigned>(), configuration_from(node),
                           node.at("sequence").get<std::uint32_t>());
    }
  } catch (const json::exception& error) {
    throw std::runtime_error(error.what());
  }
}

std::string read_state(const std::string& path) {
  std::error_code error;
  if (!std::filesystem::exists(path, error)) return "";
  std::ifstream file(path);
  if (!file) throw_errno("cannot read " + path);
  return {std::istreambuf_iterator<char>(file), {}};
}

void write_state(const std::string& path, const std::string& text) {
  const std::string fresh = path + ".new";
  const int file = ::open(fresh.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
  if (file < 0) throw_errno("cannot write " + fresh);
  const ssize_t written = ::write(file, text.data(), text.size());
  const bool is_whole = written == static_cast<ssize_t>(text.size());
  if (::close(file) != 0 || !is_whole) throw_errno("cannot write " + fresh);
  if (::rename(fresh.c_str(), path.c_str()) != 0) throw_errno("cannot write " + path);
}

}  // namespace slamgw::sim::ble
