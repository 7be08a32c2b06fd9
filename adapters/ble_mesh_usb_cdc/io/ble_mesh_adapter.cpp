// SPDX-License-Identifier: Apache-2.0
#include "adapters/ble_mesh_usb_cdc/io/ble_mesh_adapter.hpp"

#include <fmt/format.h>

#include <algorithm>

#include "adapters/ble_mesh_usb_cdc/io/mesh_file.hpp"

namespace slamgw::ble {
namespace {

/// No two in one mesh may send from the same address: robots would drop the messages of one.
void check_address(const NodeDatabase& database, std::uint16_t address, std::string& problem) {
  if (const Node* const taken = database.find_address(address))
    problem = fmt::format(
        "ble_mesh.address 0x{:04x} is a robot's (UUID {} in mesh.json): choose one that none has",
        address, to_hex(taken->uuid));
  if (database.guest_address && *database.guest_address != address)
    problem = fmt::format(
        "ble_mesh.address must be 0x{:04x}, which the gateway that provisions this mesh has given "
        "this one",
        *database.guest_address);
  if (std::ranges::find(database.gateways, address) != database.gateways.end())
    problem = fmt::format(
        "ble_mesh.address 0x{:04x} was given to another gateway of this mesh: choose one that none "
        "has",
        address);
}

}  // namespace

LoadedMesh load_mesh(const std::string& store_directory, const Settings& settings) {
  LoadedMesh mesh;
  if (const auto loaded = MeshFile(store_directory).load(); !loaded.has_value()) {
    mesh.problem = loaded.error().why;
  } else {
    mesh.database = *loaded;
  }
  if (mesh.database) check_address(*mesh.database, settings.address, mesh.problem);
  return mesh;
}

}  // namespace slamgw::ble
