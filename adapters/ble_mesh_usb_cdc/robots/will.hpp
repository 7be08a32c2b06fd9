// SPDX-License-Identifier: Apache-2.0
// `ble_mesh.will`: what the gateway publishes for a robot that went silent. Called by the meshes.
#pragma once

#include <string_view>

#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/messages.hpp"

namespace slamgw::ble {

/// `{id}` in the topic stands for `robot`; the message is taken as it is.
Report will_report(const WillSettings& will, std::string_view robot);

}  // namespace slamgw::ble
