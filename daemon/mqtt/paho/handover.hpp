// SPDX-License-Identifier: Apache-2.0
// From one thread to another, in order: what is given before the taker gets to look costs it one
// wake-up together. Bounding what waits is the giver's. Any threads.
#pragma once

#include <mutex>
#include <utility>
#include <vector>

namespace slamgw {

template <class Item>
class Handover {
 public:
  /// How many wait now: at 1 the taker has to be woken, who must take() then.
  std::size_t give(Item item) {
    const std::lock_guard lock(mutex_);
    items_.push_back(std::move(item));
    return items_.size();
  }

  std::vector<Item> take() {
    const std::lock_guard lock(mutex_);
    return std::exchange(items_, {});
  }

 private:
  std::mutex mutex_;
  std::vector<Item> items_;
};

}  // namespace slamgw
