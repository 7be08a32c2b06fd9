// SPDX-License-Identifier: Apache-2.0
// `<store.directory>/mesh.json` on disk: readable by its owner only, replaced atomically. Writing
// blocks until it is on disk, so BleMeshShell writes from a thread of its own.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "adapters/ble_mesh_usb_cdc/errors.hpp"
#include "adapters/ble_mesh_usb_cdc/provisioning/node_database.hpp"
#include "adapters/ble_mesh_usb_cdc/settings.hpp"
#include "daemon/core/result.hpp"

namespace slamgw::ble {

class MeshFile {
 public:
  explicit MeshFile(const std::string& directory) : path_(directory + "/mesh.json") {}

  /// Nothing when there is no file. The error is a sentence for the operator; a file that can't be
  /// read must not be replaced, because the mesh is lost with its keys.
  Result<std::optional<NodeDatabase>, Refusal> load() const;
  /// An error message, or empty when the file is safely on disk. Never replaces an existing file.
  std::string create(const NodeDatabase& database) const;
  /// The same for a mesh that goes on.
  std::string replace(const NodeDatabase& database) const;

  const std::string& path() const { return path_; }

 private:
  std::string write(const NodeDatabase& database,
                    int (*put_in_place)(const char*, const char*)) const;

  std::string path_;
};

/// The content of `mesh.json`.
struct LoadedMesh {
  std::optional<NodeDatabase> database;
  std::string problem;  ///< why the mesh must stay off; else empty
};
/// From `mesh.json` in this directory; blocks.
LoadedMesh load_mesh(const std::string& store_directory, const Settings& settings);

/// A RandomSource: the system's.
bool fill_random(std::span<std::uint8_t> octets);
/// Fresh random keys; nothing when the system has no randomness to give.
std::optional<MeshKeys> generate_random_keys();

}  // namespace slamgw::ble
