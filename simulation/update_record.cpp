// SPDX-License-Identifier: Apache-2.0
#include "simulation/update_record.hpp"

#include <fmt/format.h>

#include <chrono>
#include <stdexcept>

namespace slamgw::sim {

UpdateRecord::UpdateRecord(const std::string& path) {
  if (path.empty()) return;
  file_.open(path);
  if (!file_) throw std::runtime_error(path + " can't be written");
}

void UpdateRecord::write(const std::string& id, const UpdateEvent& event) {
  const std::chrono::duration<double> since_1970 =
      std::chrono::system_clock::now().time_since_epoch();
  if (event.is_acknowledged) {
    file_ << fmt::format("acknowledged {} {} {:.6f}\n", id, event.number, since_1970.count());
  } else {
    file_ << fmt::format("sent {} {} {:02x} {:.6f}\n", id, event.number,
                         fmt::join(event.payload, ""), since_1970.count());
  }
  file_.flush();
}

}  // namespace slamgw::sim
