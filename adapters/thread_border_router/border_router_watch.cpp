// SPDX-License-Identifier: Apache-2.0
#include "adapters/thread_border_router/border_router_watch.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <string_view>
#include <utility>

#include "daemon/core/utf8.hpp"

namespace slamgw::border_router {
namespace {

using nlohmann::json;

json or_null(const auto& value) { return value ? json(*value) : json(nullptr); }
json rssi(std::int8_t dbm) { return dbm == Neighbour::no_rssi ? json(nullptr) : json(int{dbm}); }
json rloc16_text(std::uint16_t rloc16) {
  constexpr std::uint16_t none = 0xfffe;  // of a node without a network
  return rloc16 == none ? json(nullptr) : json(fmt::format("{:#06x}", rloc16));
}
json address_text(std::uint64_t address) { return fmt::format("{:016x}", address); }

json to_json(const Neighbour& neighbour) {
  const double error_rate = std::round(neighbour.frame_errors * 1000.0 / 0xffff) / 1000;
  return {{"extended_address", address_text(neighbour.extended_address)},
          {"rloc16", rloc16_text(neighbour.rloc16)},
          {"child", neighbour.is_child},
          {"sleepy", !neighbour.is_always_on},
          {"link_quality", neighbour.link_quality},
          {"rssi_average_dbm", rssi(neighbour.rssi_average_dbm)},
          {"rssi_last_dbm", rssi(neighbour.rssi_last_dbm)},
          {"frame_error_rate", error_rate}};
}

std::string to_document(const NodeFacts& facts) {
  json neighbours;
  if (facts.neighbours) neighbours = json::array();
  for (const Neighbour& neighbour : facts.neighbours.value_or(std::vector<Neighbour>()))
    neighbours.push_back(to_json(neighbour));
  const json document{
      {"role", or_null(facts.role)},
      {"network_name", or_null(facts.network_name)},
      {"channel", or_null(facts.channel)},
      {"rloc16", facts.rloc16 ? rloc16_text(*facts.rloc16) : json(nullptr)},
      {"extended_address",
       facts.extended_address ? address_text(*facts.extended_address) : json(nullptr)},
      {"partition_id", or_null(facts.partition_id)},
      {"leader_router_id", or_null(facts.leader_router_id)},
      {"neighbours", std::move(neighbours)},
      {"left_out", facts.left_out}};
  return escape_unprintable(document.dump(-1, ' ', false, json::error_handler_t::replace));
}

/// Removes values that Thread does not have.
void check(NodeFacts& facts) {
  constexpr std::array<std::string_view, 5> roles{"disabled", "detached", "child", "router",
                                                  "leader"};
  constexpr std::size_t longest_name = 16;
  if (facts.role && std::ranges::count(roles, *facts.role) == 0) facts.role.reset();
  if (facts.network_name && facts.network_name->size() > longest_name) facts.network_name.reset();
  if (facts.channel && (*facts.channel < 11 || *facts.channel > 26)) facts.channel.reset();
}

}  // namespace

void BorderRouterWatch::on_broker_link(bool is_up) {
  is_broker_up_ = is_up;
  published_.reset();
  publish();
}

void BorderRouterWatch::on_gone() {
  if (std::exchange(is_announced_, false))
    actions_.push(Notice{Severity::info, "Thread's border router (otbr-agent) is gone", {}});
  read_at_.reset();
  role_.clear();
  problem_.clear();
  document_.emplace();
  publish();
}

void BorderRouterWatch::on_changed(TimePoint now) {
  if (read_at_) read_at_ = std::min(*read_at_, now + settling);
}

void BorderRouterWatch::on_deadline(const Now& now) {
  if (!read_at_ || now.mono < *read_at_) return;
  read_at_.reset();
  actions_.push(ReadNode{});
}

void BorderRouterWatch::on_read(NodeFacts facts, TimePoint now) {
  read_at_ = now + interval;
  check(facts);
  role_ = facts.role.value_or("");
  if (!role_.empty() && !std::exchange(is_announced_, true))
    actions_.push(
        Notice{Severity::info, "Thread's border router (otbr-agent) is here: " + role_, {}});
  if (!facts.problem.empty() && facts.problem != problem_)
    actions_.push(Notice{Severity::warning, "otbr-agent: " + facts.problem, {}});
  problem_ = facts.problem;
  document_ = to_document(facts);
  publish();
}

void BorderRouterWatch::publish() {
  if (!is_broker_up_ || !document_ || document_ == published_) return;
  published_ = document_;
  actions_.push(PublishDocument{*document_});
}

}  // namespace slamgw::border_router
