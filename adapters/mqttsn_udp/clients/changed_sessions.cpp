// SPDX-License-Identifier: Apache-2.0
#include "adapters/mqttsn_udp/clients/changed_sessions.hpp"

#include <utility>

#include "adapters/mqttsn_udp/limits.hpp"

namespace slamgw::mqttsn {

void ChangedSessions::mark(const ClientSession& session) {
  if (client_ids_.size() < limits::max_dirty) client_ids_.insert(session.client_id);
}

std::vector<std::string> ChangedSessions::take(std::size_t max) {
  std::vector<std::string> ids;
  while (!client_ids_.empty() && ids.size() < max)
    ids.push_back(std::move(client_ids_.extract(client_ids_.begin()).value()));
  return ids;
}

}  // namespace slamgw::mqttsn
