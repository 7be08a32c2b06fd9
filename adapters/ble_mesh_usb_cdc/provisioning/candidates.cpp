// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/provisioning/candidates.hpp"

#include <algorithm>
#include <tuple>

namespace slamgw::ble {
namespace {

bool is_there(const Candidate& candidate, TimePoint now) {
  return now - candidate.last_heard <= Candidates::max_silence;
}

}  // namespace

Duration pause_after(int failures) {
  Duration pause = Candidates::first_pause;
  for (int i = 1; i < failures && pause < Candidates::max_pause; ++i) pause *= 2;
  return std::min(pause, Candidates::max_pause);
}

void Candidates::on_beacon(const UnprovisionedBeacon& beacon, TimePoint now) {
  auto known = candidates_.find(beacon.uuid);
  if (known == candidates_.end()) {
    if (candidates_.size() >= max_candidates)
      candidates_.erase(std::ranges::min_element(
          candidates_, {}, [](const auto& entry) { return entry.second.last_heard; }));
    known = candidates_.try_emplace(beacon.uuid).first;
    known->second.uuid = beacon.uuid;
    known->second.first_heard = now;
  }
  known->second.rssi_dbm = beacon.rssi_dbm;
  known->second.last_heard = now;
}

void Candidates::on_failure(const Uuid& uuid, TimePoint now) {
  const auto known = candidates_.find(uuid);
  if (known == candidates_.end()) return;
  known->second.not_before = now + pause_after(++known->second.failures);
}

void Candidates::on_elements(const Uuid& uuid, std::uint8_t elements) {
  const auto known = candidates_.find(uuid);
  if (known != candidates_.end()) known->second.elements = elements;
}

const Candidate* Candidates::find(const Uuid& uuid, TimePoint now) const {
  const auto known = candidates_.find(uuid);
  if (known == candidates_.end() || !is_there(known->second, now)) return nullptr;
  return &known->second;
}

const Candidate* Candidates::next(const Filter& is_wanted, TimePoint now) const {
  const Candidate* best = nullptr;
  const auto rank = [](const Candidate& candidate) {
    return std::tuple(candidate.failures, candidate.first_heard);
  };
  for (const auto& [uuid, candidate] : candidates_) {
    if (now < candidate.not_before || !is_there(candidate, now) || !is_wanted(candidate)) continue;
    if (best == nullptr || rank(candidate) < rank(*best)) best = &candidate;
  }
  return best;
}

std::vector<Candidate> Candidates::all(TimePoint now) const {
  std::vector<Candidate> all;
  for (const auto& [uuid, candidate] : candidates_)
    if (is_there(candidate, now)) all.push_back(candidate);
  return all;
}

}  // namespace slamgw::ble
