// SPDX-License-Identifier: Apache-2.0
// Closes a file descriptor at its end, and leaves errno as it is.
#pragma once

#include <unistd.h>

#include <cerrno>
#include <utility>

namespace slamgw {

class OwnedFile {
 public:
  explicit OwnedFile(int descriptor = -1) : descriptor_(descriptor) {}
  ~OwnedFile() {
    const int error = errno;
    if (descriptor_ >= 0) ::close(descriptor_);
    errno = error;
  }
  OwnedFile(OwnedFile&& other) noexcept : descriptor_(other.release()) {}
  OwnedFile& operator=(OwnedFile&& other) noexcept {
    std::swap(descriptor_, other.descriptor_);
    return *this;
  }
  int get() const { return descriptor_; }
  /// Returns the descriptor, which the caller then owns.
  int release() { return std::exchange(descriptor_, -1); }

 private:
  int descriptor_;
};

}  // namespace slamgw
