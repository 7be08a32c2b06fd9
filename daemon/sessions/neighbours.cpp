// SPDX-License-Identifier: Apache-2.0
#include "daemon/sessions/neighbours.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <utility>

namespace slamgw::sessions {
namespace {

using nlohmann::json;

/// Returns nothing when the document is not an object, or too large to be from a gateway.
std::optional<json> parse(ByteView document) {
  if (document.empty() || document.size() > Neighbours::max_document_octets) return std::nullopt;
  json parsed = json::parse(document.begin(), document.end(), nullptr, false);
  if (!parsed.is_object()) return std::nullopt;
  return parsed;
}

std::string text_of(const json& document, const char* key) {
  const auto found = document.find(key);
  return found != document.end() && found->is_string() ? found->get<std::string>() : std::string();
}

}  // namespace

std::vector<Neighbours::Orphan> Neighbours::on_state(const std::string& gateway,
                                                     ByteView document) {
  if (gateway == own_id_) return {};
  const auto parsed = parse(document);
  const bool was_online = is_online(gateway);
  if (document.empty()) {
    gateways_.erase(gateway);
  } else if (gateways_.contains(gateway) || gateways_.size() < max_gateways) {
    gateways_[gateway] = {};
    if (parsed)
      gateways_[gateway] = {text_of(*parsed, "state") == "online", text_of(*parsed, "version"),
                            text_of(*parsed, "since"), text_of(*parsed, "connected")};
  }
  if (!was_online || is_online(gateway)) return {};
  std::vector<Orphan> of_gateway = orphans();
  std::erase_if(of_gateway,
                [&](const Orphan& orphan) { return robots_.at(orphan.robot).gateway != gateway; });
  return of_gateway;
}

std::vector<Neighbours::Orphan> Neighbours::orphans() const {
  std::vector<Orphan> orphans;
  const Duration after = orphan_delay + rank() * rank_delay;
  for (const auto& [robot, shown] : robots_)
    if (!is_online(shown.gateway)) orphans.push_back({robot, after});
  return orphans;
}

void Neighbours::on_presence(const std::string& gateway, const std::string& robot,
                             ByteView document) {
  if (gateway == own_id_) return;
  const auto parsed = parse(document);
  const auto known = robots_.find(robot);
  if (!parsed) return on_withdrawn(gateway, robot);
  if (known == robots_.end() && robots_.size() >= max_robots) return;
  RobotPresence shown{gateway, text_of(*parsed, "state"), text_of(*parsed, "since"),
                      std::string(as_text(document))};
  // An `offline` does not replace the presence that another gateway shows, unless that one is gone.
  const bool is_older = known != robots_.end() && known->second.gateway != gateway &&
                        shown.state == "offline" && known->second.state != "offline" &&
                        !is_gone(known->second.gateway);
  if (is_older) return;
  if (known != robots_.end() && known->second.gateway != gateway)
    former_[robot] = std::move(known->second);
  robots_[robot] = std::move(shown);
}

/// Restores the former gateway's presence: a gateway that loses a robot may show it once more
/// before it withdraws it.
void Neighbours::on_withdrawn(const std::string& gateway, const std::string& robot) {
  const auto known = robots_.find(robot);
  if (known == robots_.end()) return;
  auto former = former_.extract(robot);
  const bool is_shown = former && former.mapped().gateway != gateway;
  if (known->second.gateway != gateway) {
    if (is_shown) former_.insert(std::move(former));
  } else if (is_shown && is_online(former.mapped().gateway)) {
    known->second = std::move(former.mapped());
  } else {
    robots_.erase(known);
  }
}

void Neighbours::on_broker_up(bool is_other) {
  for (auto& [gateway, state] : gateways_) state.is_shown = false;
  if (!is_other) return;
  gateways_.clear();
  robots_.clear();
  former_.clear();
}

void Neighbours::on_settled() {
  for (auto& [gateway, state] : gateways_)
    state.is_online = state.is_online && (state.is_shown || state.connected.empty());
}

bool Neighbours::is_served_elsewhere(const std::string& robot) const {
  const auto found = robots_.find(robot);
  return found != robots_.end() && is_online(found->second.gateway);
}

bool Neighbours::is_heard_elsewhere(const std::string& robot) const {
  return is_served_elsewhere(robot) && robots_.at(robot).state != "offline";
}

bool Neighbours::is_gone(const std::string& gateway) const {
  return gateways_.contains(gateway) && !is_online(gateway);
}

bool Neighbours::is_online(const std::string& gateway) const {
  const auto found = gateways_.find(gateway);
  return found != gateways_.end() && found->second.is_online;
}

/// Returns the number of living gateways that come before this one by name.
unsigned Neighbours::rank() const {
  return static_cast<unsigned>(std::ranges::count_if(
      gateways_, [&](const auto& each) { return each.second.is_online && each.first < own_id_; }));
}

}  // namespace slamgw::sessions
