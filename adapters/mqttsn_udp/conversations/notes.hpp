// SPDX-License-Identifier: Apache-2.0
// What another gateway needs to go on with the session of a client that keeps it (CleanSession 0):
// reported whenever it changes, a little later, so that what a client sets up together is one note.
#pragma once

#include "adapters/mqttsn_udp/clients/client_table.hpp"
#include "adapters/mqttsn_udp/output.hpp"

namespace slamgw::mqttsn {

class Notes {
 public:
  Notes(const ClientTable& clients, Output& output) : clients_(clients), output_(output) {}

  std::optional<TimePoint> deadline() const;
  void on_deadline(TimePoint now);

 private:
  void update(ClientSession& session, TimePoint now);

  const ClientTable& clients_;
  Output& output_;
  std::optional<TimePoint> due_;  // nothing: no change was seen since the last notes
};

}  // namespace slamgw::mqttsn
