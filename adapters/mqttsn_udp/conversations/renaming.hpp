// SPDX-License-Identifier: Apache-2.0
// The configuration gives robots other names while their clients are connected: each session goes
// on under the new name, unnoticed by its client.
#pragma once

#include "adapters/mqttsn_udp/conversations/connecting.hpp"

namespace slamgw::mqttsn {

class Renaming {
 public:
  Renaming(const NameRules& rules, ClientTable& clients, Output& output,
           Subscriptions& subscriptions, Lifecycle& lifecycle, const Connecting& connecting)
      : rules_(rules),
        clients_(clients),
        output_(output),
        subscriptions_(subscriptions),
        lifecycle_(lifecycle),
        connecting_(connecting) {}

  /// NameRules has new names. Disconnects a client whose id is now another robot's name.
  void on_names(TimePoint now);

 private:
  /// A session, and what its robot is called from now on.
  struct Renamed {
    ClientSession* session = nullptr;
    std::string robot;
  };

  void leave_name(ClientSession& session, TimePoint now);
  void enter_name(const Renamed& renamed, TimePoint now);

  const NameRules& rules_;
  ClientTable& clients_;
  Output& output_;
  Subscriptions& subscriptions_;
  Lifecycle& lifecycle_;
  const Connecting& connecting_;
};

}  // namespace slamgw::mqttsn
