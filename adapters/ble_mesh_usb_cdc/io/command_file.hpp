// SPDX-License-Identifier: Apache-2.0
// `<store.directory>/ble-commands.json` on disk. Written in place and without waiting for the disk:
// it outlives any end of the process, and costs an SD card one write in some seconds however many
// commands there are. BleMeshAdapter writes from a thread of its own.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "adapters/ble_mesh_usb_cdc/robots/command_queue.hpp"

namespace slamgw::ble {

class CommandFile {
 public:
  explicit CommandFile(const std::string& directory) : path_(directory + "/ble-commands.json") {}

  /// Empty when there is no file. Nothing when it is damaged or can't be read.
  std::optional<std::vector<OpenCommand>> load(const Now& now) const;
  /// `text` of encode_open_commands. An error message, or empty when it was written.
  std::string write(const std::string& text) const;

  const std::string& path() const { return path_; }

 private:
  std::string path_;
};

}  // namespace slamgw::ble
