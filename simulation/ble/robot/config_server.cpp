// SPDX-License-Identifier: Apache-2.0
#include "simulation/ble/robot/config_server.hpp"

namespace slamgw::sim::ble {
namespace {

constexpr std::uint16_t composition_status_op = 0x02;
constexpr std::uint16_t composition_get_op = 0x8008;
constexpr std::uint16_t node_reset_op = 0x8049;
constexpr std::uint16_t node_reset_status_op = 0x804a;

constexpr std::uint16_t product = 0x0001;
constexpr std::uint16_t version = 0x0001;
constexpr std::uint16_t replay_list_entries = 40;
constexpr std::uint16_t features = 0x0001;  // relay
constexpr std::uint8_t page_0 = 0x00;
constexpr std::uint8_t last_page = 0xff;

}  // namespace

ConfigServer::ConfigServer(const Firmware& firmware, NodeConfiguration& configuration)
    : configuration_(configuration),
      keys_(configuration),
      features_(configuration),
      bindings_(configuration),
      publications_(firmware, configuration),
      subscriptions_(configuration) {}

ConfigServer::Result ConfigServer::on_message(ByteView message) {
  if (message.empty()) return {};
  const bool has_one_octet = (message[0] & 0x80) == 0;
  if (!has_one_octet && !two_octet_opcode(message)) return {};
  const std::uint16_t opcode = has_one_octet ? message[0] : *two_octet_opcode(message);
  const ByteView parameters = message.subspan(has_one_octet ? 1 : 2);
  if (opcode == node_reset_op && parameters.empty()) {
    return {begin_message(node_reset_status_op), true};
  }
  const Answer answer = answer_to(opcode, parameters).value_or(std::nullopt);
  for (const auto& failed : {publications_.failed_assertion(), subscriptions_.failed_assertion()}) {
    if (failed) return {std::nullopt, false, failed};
  }
  return {answer};
}

std::optional<Answer> ConfigServer::answer_to(std::uint16_t opcode, ByteView parameters) {
  if (opcode == composition_get_op) return composition_get(parameters);
  if (auto answer = keys_.on_message(opcode, parameters)) return answer;
  if (auto answer = features_.on_message(opcode, parameters)) return answer;
  if (auto answer = bindings_.on_message(opcode, parameters)) return answer;
  if (auto answer = publications_.on_message(opcode, parameters)) return answer;
  return subscriptions_.on_message(opcode, parameters);
}

/// Answers with page 0, which is the only one.
Answer ConfigServer::composition_get(ByteView parameters) const {
  if (parameters.size() != 1) return std::nullopt;
  if (parameters[0] != page_0 && parameters[0] != last_page) return std::nullopt;
  Bytes sig_models;
  Bytes vendor_models;
  std::uint8_t sig_count = 0;
  std::uint8_t vendor_count = 0;
  for (const Model& model : configuration_.models) {
    const bool is_sig = model.id.company == ModelId::sig;
    put_model_id(is_sig ? sig_models : vendor_models, model.id);
    ++(is_sig ? sig_count : vendor_count);
  }
  Bytes out = begin_message(composition_status_op);
  put_u8(out, page_0);
  for (const std::uint16_t field : {nordic, product, version, replay_list_entries, features}) {
    put_u16_le(out, field);
  }
  put_u16_le(out, 0x0000);  // location of the one element: unknown
  put(out, Bytes{sig_count, vendor_count});
  put(out, sig_models);
  put(out, vendor_models);
  return out;
}

}  // namespace slamgw::sim::ble
