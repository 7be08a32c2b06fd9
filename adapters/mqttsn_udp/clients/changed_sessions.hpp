// SPDX-License-Identifier: Apache-2.0
// The clients whose sessions have changed or ended since they were last written to disk.
#pragma once

#include <set>
#include <string>
#include <vector>

#include "adapters/mqttsn_udp/clients/client_session.hpp"

namespace slamgw::mqttsn {

class ChangedSessions {
 public:
  /// Something that must survive a restart has changed.
  void mark(const ClientSession& session);
  void unmark(const std::string& client_id) { client_ids_.erase(client_id); }
  bool has(const ClientSession& session) const { return client_ids_.contains(session.client_id); }
  bool has_any() const { return !client_ids_.empty(); }
  /// Client ids, at most `max`; they are not marked any more.
  std::vector<std::string> take(std::size_t max);

 private:
  std::set<std::string> client_ids_;  // at most max_dirty
};

}  // namespace slamgw::mqttsn
