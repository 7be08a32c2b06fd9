// SPDX-License-Identifier: Apache-2.0
// Devices that say they are in no mesh: when each was heard, and which is next. After a failure a
// device waits longer each time, so that it does not hold up the others. Called by Admission.
#pragma once

#include <functional>
#include <map>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/nordic/events.hpp"
#include "daemon/core/time.hpp"

namespace slamgw::ble {

struct Candidate {
  Uuid uuid{};
  std::int8_t rssi_dbm = 0;
  TimePoint first_heard{};
  TimePoint last_heard{};
  TimePoint not_before{};  ///< of the next attempt
  int failures = 0;
  std::uint8_t elements = 1;  ///< as it said at an earlier attempt
};

class Candidates {
 public:
  /// The one that was silent for longest makes room.
  static constexpr std::size_t max_candidates = 64;
  /// Beacons come every few seconds (Mesh Profile 1.0 section 3.9.2); one silent for this long has
  /// gone.
  static constexpr Duration max_silence = std::chrono::seconds{60};
  static constexpr Duration first_pause = std::chrono::seconds{5};
  static constexpr Duration max_pause = std::chrono::minutes{5};

  using Filter = std::function<bool(const Candidate&)>;

  void on_beacon(const UnprovisionedBeacon& beacon, TimePoint now);
  void on_failure(const Uuid& uuid, TimePoint now);
  void on_elements(const Uuid& uuid, std::uint8_t elements);
  void erase(const Uuid& uuid) { candidates_.erase(uuid); }

  const Candidate* find(const Uuid& uuid, TimePoint now) const;
  /// The one with the fewest failures, then the first heard, among those that are due and wanted.
  const Candidate* next(const Filter& is_wanted, TimePoint now) const;
  /// The devices that were heard lately.
  std::vector<Candidate> all(TimePoint now) const;

 private:
  std::map<Uuid, Candidate> candidates_;
};

/// 5 s, 10 s, 20 s ... after the first, second, third failure; at most five minutes.
Duration pause_after(int failures);

}  // namespace slamgw::ble
