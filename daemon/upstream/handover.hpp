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
  /// True when the taker has to be woken; it must take() then.
  bool give(Item item) {
    const std::lock_guard lock(mutex_);
    items_.push_back(std::move(item));
    return items_.size() == 1;
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
