// SPDX-License-Identifier: Apache-2.0
// `<store.directory>/mesh.json` on disk: readable by its owner only, replaced atomically. Writing
// blocks until the file is on disk, so BleMeshShell writes from a thread of its own.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ble {

class MeshFile {
 public:
  explicit MeshFile(const std::string& directory) : path_(directory + "/mesh.json") {}

  /// Returns nothing if there is no file. The error says why the mesh must stay off. A file that
  /// can't be read must not be replaced: without its keys the mesh is lost. Checks `address`,
  /// `ble_mesh.address`, against the file. Blocks, for some seconds if the disk fails.
  Result<std::optional<NodeDatabase>, Refusal> load(std::uint16_t address) const;
  /// Returns an error message, empty if the file is on disk. `is_new`: never replaces an existing
  /// file.
  std::string write(const NodeDatabase& database, bool is_new = false) const;

  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

/// The system's RandomSource.
bool fill_random(std::span<std::uint8_t> octets);

}  // namespace slamgw::ble
