// SPDX-License-Identifier: Apache-2.0
// The base of the classes in this folder.
#pragma once

#include "adapters/mqttsn_udp/clients/client_table.hpp"
#include "adapters/mqttsn_udp/conversations/refusals.hpp"
#include "adapters/mqttsn_udp/name_rules.hpp"
#include "adapters/mqttsn_udp/output.hpp"
#include "adapters/mqttsn_udp/settings.hpp"

namespace slamgw::mqttsn {

/// The parts of the machine that each conversation works with; all outlive it.
class Conversation {
 public:
  Conversation(const Settings& settings, const NameRules& rules, ClientTable& clients,
               Output& output, Refusals& refusals)
      : settings_(settings),
        rules_(rules),
        clients_(clients),
        output_(output),
        refusals_(refusals) {}

 protected:
  const Settings& settings_;
  const NameRules& rules_;
  ClientTable& clients_;
  Output& output_;
  Refusals& refusals_;
};

}  // namespace slamgw::mqttsn
