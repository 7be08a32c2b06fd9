// SPDX-License-Identifier: Apache-2.0
// An allocator for containers that gain and lose a node with each message. It reuses the freed
// blocks, so that a warm path allocates nothing. Each thread has a pool of its own.
#pragma once

#include <array>
#include <cstddef>
#include <new>
#include <utility>

namespace slamgw {

/// Free blocks of one thread, by size.
class BlockPool {
 public:
  /// Larger blocks, and blocks freed beyond `max_kept_bytes`, go back to the heap at once.
  static constexpr std::size_t largest_block = 1024;
  static constexpr std::size_t max_kept_bytes = 1u << 20;

  static BlockPool& of_this_thread() {
    thread_local BlockPool pool;
    return pool;
  }
  BlockPool() = default;
  ~BlockPool() {
    for (Block* first : free_) {
      while (first) ::operator delete(std::exchange(first, first->next));
    }
  }
  BlockPool(const BlockPool&) = delete;
  BlockPool& operator=(const BlockPool&) = delete;

  void* take(std::size_t bytes) {
    if (bytes > largest_block) return ::operator new(bytes);
    Block*& first = free_[class_of(bytes)];
    if (!first) return ::operator new((class_of(bytes) + 1) * step);
    kept_bytes_ -= (class_of(bytes) + 1) * step;
    return std::exchange(first, first->next);
  }
  void give_back(void* memory, std::size_t bytes) {
    const std::size_t size = (class_of(bytes) + 1) * step;
    if (bytes > largest_block || kept_bytes_ + size > max_kept_bytes)
      return ::operator delete(memory);
    Block*& first = free_[class_of(bytes)];
    first = new (memory) Block{first};
    kept_bytes_ += size;
  }

 private:
  static constexpr std::size_t step = alignof(std::max_align_t);
  struct Block {
    Block* next;
  };
  static std::size_t class_of(std::size_t bytes) { return (bytes - 1) / step; }

  std::array<Block*, largest_block / step> free_{};
  std::size_t kept_bytes_ = 0;
};

template <class T>
struct RecyclingAllocator {
  using value_type = T;
  static_assert(alignof(T) <= alignof(std::max_align_t));

  RecyclingAllocator() = default;
  template <class Other>
  RecyclingAllocator(const RecyclingAllocator<Other>&) {}

  T* allocate(std::size_t count) {
    return static_cast<T*>(BlockPool::of_this_thread().take(count * sizeof(T)));
  }
  void deallocate(T* memory, std::size_t count) {
    BlockPool::of_this_thread().give_back(memory, count * sizeof(T));
  }
  bool operator==(const RecyclingAllocator&) const { return true; }
};

}  // namespace slamgw
