// SPDX-License-Identifier: Apache-2.0
// `<store.directory>/other-gateways`: it is there when others were on this gateway's broker while
// it ran last. A gateway that starts then takes part in the fleet at once, also when the broker is
// in no state to say who else is `online`.
#pragma once

#include <boost/asio/thread_pool.hpp>
#include <optional>
#include <string>

namespace slamgw {

class FleetMemory {
 public:
  explicit FleetMemory(const std::string& directory) : path_(directory + "/other-gateways") {}

  /// False also when the file cannot be read. Called before the loop runs.
  bool were_others_about() const;
  /// On a thread of its own. What cannot be written is not remembered.
  void remember(bool are_others_about);
  /// Waits for what is being written.
  void stop();

 private:
  std::string path_;
  std::optional<boost::asio::thread_pool> disk_;  ///< most gateways never need one
};

}  // namespace slamgw
