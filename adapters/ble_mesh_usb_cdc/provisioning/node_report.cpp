// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/node_report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <nlohmann/json.hpp>

namespace slamgw::ble {
namespace {

using OrderedJson = nlohmann::ordered_json;

std::string text_of(const OrderedJson& json) {
  return json.dump(-1, ' ', false, OrderedJson::error_handler_t::replace);
}

/// Returns the name that the thesis or Bluetooth gives the model, else its number.
std::string name_of(const ModelId& model) {
  constexpr std::array names{"Simple OnOff server",
                             "Simple OnOff client",
                             "",
                             "",
                             "min_com client",
                             "min_com server",
                             "sensor_update client",
                             "sensor_update server",
                             "pos_cmd client",
                             "pos_cmd server"};
  if (model == ModelId{{}, 0x0002}) return "Health server";
  if (model == ModelId{{}, 0x1000}) return "Generic OnOff server";
  const bool is_known = model.company == nordic && model.number < names.size();
  const std::string name = is_known ? names[model.number] : "";
  return name.empty() ? to_string(model) : name;
}

OrderedJson transmissions_json(const Transmissions& transmissions) {
  return {{"sends", transmissions.sends}, {"interval_ms", transmissions.interval_ms}};
}

/// The node's three states of relaying (Mesh Profile 1.0 section 4.2.8).
OrderedJson relay_json(ByteView params) {
  constexpr std::size_t size = 2;
  constexpr std::array states{"off", "on", "not supported"};
  if (params.size() != size || params[0] >= states.size()) return nullptr;
  OrderedJson relay{{"state", states[params[0]]}};
  relay.update(transmissions_json(decode_transmissions(params[1])));
  return relay;
}

OrderedJson& row_of(OrderedJson& models, const ModelElement& about) {
  const auto is_row = [&](const OrderedJson& row) {
    return row["element"] == address_text(about.element) && row["model"] == to_string(about.model);
  };
  const auto found = std::ranges::find_if(models, is_row);
  if (found != models.end()) return *found;
  models.push_back({{"element", address_text(about.element)},
                    {"model", to_string(about.model)},
                    {"name", name_of(about.model)}});
  return models.back();
}

void add_model_answer(OrderedJson& models, const NodeAnswer& answer) {
  if (answer.params.empty() || answer.params[0] != 0) return;  // the problem names the refusal
  OrderedJson& row = row_of(models, *answer.about);
  if (answer.opcode == model_publication_get.answer) {
    const auto publication = decode_publication(answer.params);
    if (!publication) return;
    row["publishes_to"] = address_text(publication->address);
    row["publish_ttl"] = publication->ttl;
  } else {
    row["subscribed_to"] = OrderedJson::array();
    for (const auto group : decode_subscription_list(answer.params, answer.about->model))
      row["subscribed_to"].push_back(address_text(group));
  }
}

void add_answer(OrderedJson& report, OrderedJson& models, const NodeAnswer& answer) {
  if (answer.about) return add_model_answer(models, answer);
  if (answer.params.empty()) return;
  switch (answer.opcode) {
    case default_ttl_get.answer: report["ttl"] = answer.params[0]; break;
    case relay_get.answer: report["relay"] = relay_json(answer.params); break;
    case network_transmit_get.answer:
      report["transmit"] = transmissions_json(decode_transmissions(answer.params[0]));
      break;
    default: break;
  }
}

OrderedJson wanted_json(const NodeWishes& wishes) {
  OrderedJson wanted = OrderedJson::object();
  if (wishes.ttl) wanted["ttl"] = *wishes.ttl;
  if (wishes.relay) wanted["relay"] = *wishes.relay ? "on" : "off";
  if (wishes.transmit) wanted["transmit"] = transmissions_json(*wishes.transmit);
  for (const std::uint16_t group : wishes.groups)
    wanted["subscribed_to"].push_back(address_text(group));
  for (const auto& [model, address] : wishes.publications)
    wanted["publishes_to"][model] = address_text(address);
  return wanted;
}

/// Warns of wanted publications that do not come to the gateway.
OrderedJson warnings_json(const OrderedJson& models, const NodeWishes& wishes, const Hears& hears) {
  OrderedJson warnings = OrderedJson::array();
  for (const auto& [model, address] : wishes.publications) {
    const auto is_it = [&id = model](const OrderedJson& row) { return row["model"] == id; };
    if (std::ranges::none_of(models, is_it))
      warnings.push_back("the robot has no model " + model);
    else if (!hears(address))
      warnings.push_back(fmt::format(
          "the gateway does not hear 0x{:04x}: messages of model {} no longer reach the broker",
          address, model));
  }
  return warnings;
}

}  // namespace

std::optional<ModelId> find_publisher(std::string_view name) {
  for (const ModelId& model : publishers) {
    const std::string full = name_of(model);
    if (name == to_string(model) || name == full || name == full.substr(0, full.rfind(' ')))
      return model;
  }
  return std::nullopt;
}

std::string ping_json(const std::string& robot, const NodeConfiguration& ping) {
  using Milliseconds = std::chrono::duration<double, std::milli>;
  const bool is_answered = !ping.answers().empty();
  OrderedJson json{{"robot", robot}, {"mesh", to_string(Mesh::ble)}, {"answered", is_answered}};
  if (!is_answered) {
    json["why"] = ping.problem();
    return text_of(json);
  }
  const NodeAnswer& answer = ping.answers().front();
  json["after_ms"] = Milliseconds(answer.after).count();
  json["copies"] = answer.copies;
  if (answer.ttl) json["ttl"] = *answer.ttl;
  if (answer.ttl && !answer.params.empty() && answer.params[0] >= *answer.ttl)
    json["hops"] = answer.params[0] - *answer.ttl;
  if (answer.rssi_dbm) json["rssi_dbm"] = *answer.rssi_dbm;
  return text_of(json);
}

std::string node_config_json(const std::string& robot, const Node& node,
                             const NodeConfiguration& inquiry, const Hears& hears) {
  OrderedJson json{
      {"robot", robot}, {"uuid", to_hex(node.uuid)}, {"address", address_text(node.address)}};
  OrderedJson models = OrderedJson::array();
  for (const NodeAnswer& answer : inquiry.answers()) add_answer(json, models, answer);
  const OrderedJson warnings = warnings_json(models, node.wishes, hears);
  json["models"] = std::move(models);
  json["wanted"] = wanted_json(node.wishes);
  if (!warnings.empty()) json["warnings"] = warnings;
  if (!inquiry.problem().empty()) json["problem"] = inquiry.problem();
  return text_of(json);
}

}  // namespace slamgw::ble
