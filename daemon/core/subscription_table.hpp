// SPDX-License-Identifier: Apache-2.0
// Who wants which filter, so that the broker sees one subscription for both meshes (MQTT-SN 1.2
// section 4.2, R101).
#pragma once

#include <map>
#include <string>
#include <vector>

#include "daemon/core/messages.hpp"

namespace slamgw {

class SubscriptionTable {
 public:
  /// Returns the QoS to subscribe with at the broker: the highest that anybody asked for.
  Qos add(Mesh mesh, const std::string& filter, Qos qos);
  /// True when nobody wants the filter any more.
  bool remove(Mesh mesh, const std::string& filter);
  /// The broker refused it: nobody has it any more.
  void forget(const std::string& filter) { wanted_.erase(filter); }

  /// `mesh` waits for the broker's answer about `filter`.
  void await(Mesh mesh, const std::string& filter);
  /// One mesh for each answer that was waited for; they wait no longer.
  std::vector<Mesh> answered(const std::string& filter);
  struct Waiting {
    Mesh mesh;
    std::string filter;
  };
  std::vector<Waiting> stop_waiting();

  struct Wanted {
    Qos qos = Qos::at_most_once;
    bool by_mesh[2] = {false, false};
    unsigned waiting[2] = {0, 0};
  };
  const std::map<std::string, Wanted>& wanted() const { return wanted_; }

 private:
  std::map<std::string, Wanted> wanted_;
};

}  // namespace slamgw
