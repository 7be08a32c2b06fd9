// SPDX-License-Identifier: Apache-2.0
// Keeps the memory of used texts and octets for the next ones: a passing message takes its topic,
// its payload and its answer from here and allocates nothing. A buffer that is not given back is
// simply freed. Each thread has its own spare buffers.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

namespace slamgw {

/// `Buffer` is std::string or Bytes.
template <class Buffer>
class SpareBuffers {
 public:
  /// As many messages as are under way at once on a busy gateway.
  static constexpr std::size_t max_count = 256;
  /// Larger than most topics and payloads of robots; 64 KiB for each kind and thread.
  static constexpr std::size_t max_octets = 256;

  /// Returns an empty buffer, with memory that was used before if there is any.
  static Buffer take() {
    if (spares().empty()) return {};
    Buffer buffer = std::move(spares().back());
    spares().pop_back();
    return buffer;
  }
  /// Returns a buffer with the characters or octets of `content`.
  template <class Content>
  static Buffer copy(const Content& content) {
    Buffer buffer = take();
    buffer.assign(content.begin(), content.end());
    return buffer;
  }
  static void give_back(Buffer buffer) {
    const bool has_memory = buffer.capacity() > Buffer().capacity();
    if (!has_memory || buffer.capacity() > max_octets || spares().size() == max_count) return;
    buffer.clear();
    spares().push_back(std::move(buffer));
  }

 private:
  static std::vector<Buffer>& spares() {
    thread_local std::vector<Buffer> spares;
    return spares;
  }
};

}  // namespace slamgw
