// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/join_permit.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <utility>

#include "daemon/core/bytes.hpp"

namespace slamgw::ble {

void JoinPermit::open(std::chrono::minutes time, std::string robot, TimePoint now) {
  until_ = now + std::min(time, longest);
  robot_ = std::move(robot);
  named_.reset();
  under_way_.clear();
}

bool JoinPermit::on_time(TimePoint now) {
  if (!until_ || now < *until_) return false;
  close();
  return true;
}

bool JoinPermit::admits(const Uuid& uuid) const {
  return is_open() && (robot_.empty() || named_.value_or(uuid) == uuid);
}

void JoinPermit::on_chosen(const Uuid& uuid) {
  if (!is_open()) return;
  if (!robot_.empty()) named_ = uuid;
  if (under_way_.insert(uuid).second) note("joining", uuid, robot_, {});
}

void JoinPermit::on_joined(const Uuid& uuid, const std::string& robot) {
  if (!under_way_.contains(uuid)) return;
  note("joined", uuid, robot, {});
  if (named_ == uuid) close();  // the name is given
}

void JoinPermit::on_configured(const Uuid& uuid, const std::string& robot) {
  if (under_way_.erase(uuid) > 0) note("configured", uuid, robot, {});
}

void JoinPermit::on_failed(const Uuid& uuid, const std::string& why) {
  if (under_way_.erase(uuid) == 0) return;
  note("failed", uuid, {}, why);
  if (named_ == uuid) named_.reset();
}

void JoinPermit::note(std::string_view what, const Uuid& uuid, std::string robot, std::string why) {
  if (events_.size() >= max_events) events_.pop_front();
  events_.push_back({++last_number_, what, uuid, std::move(robot), std::move(why)});
}

std::string JoinPermit::json(std::uint64_t after, TimePoint now) const {
  const Duration left = until_ ? std::max(*until_ - now, Duration::zero()) : Duration::zero();
  nlohmann::ordered_json out{
      {"seconds_left", std::chrono::ceil<std::chrono::seconds>(left).count()},
      {"under_way", under_way_.size()},
      {"last", last_number_},
      {"events", nlohmann::ordered_json::array()}};
  for (const Event& event : events_) {
    if (event.number <= after) continue;
    out["events"].push_back({{"number", event.number},
                             {"event", event.what},
                             {"uuid", to_hex(event.uuid)},
                             {"robot", event.robot},
                             {"why", event.why}});
  }
  return out.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace slamgw::ble
