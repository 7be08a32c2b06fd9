// SPDX-License-Identifier: Apache-2.0
// The list of meshes and their names. No other place counts them: arrays are PerMesh, loops go over
// all_meshes, and the compiler finds the switches.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <string_view>

namespace slamgw {

enum class Mesh : std::uint8_t { ble, thread };

/// In the order of preference when several meshes reach a command's robot equally well.
inline constexpr std::array all_meshes{Mesh::ble, Mesh::thread};

constexpr std::size_t index_of(Mesh mesh) { return static_cast<std::size_t>(mesh); }
static_assert(std::ranges::all_of(all_meshes,
                                  [](Mesh mesh) { return index_of(mesh) < all_meshes.size(); }));

/// The mesh's name in topics, in JSON and in the log.
constexpr std::string_view to_string(Mesh mesh) {
  switch (mesh) {
    case Mesh::ble: return "ble";
    case Mesh::thread: return "thread";
  }
  return {};
}

/// A mesh without a default: a struct with such a member can't be made without naming its mesh.
class RequiredMesh {
 public:
  constexpr RequiredMesh(Mesh mesh) : mesh_(mesh) {}
  constexpr operator Mesh() const { return mesh_; }

 private:
  Mesh mesh_;
};

/// One `T` for each mesh.
template <class T>
class PerMesh {
 public:
  T& operator[](Mesh mesh) { return values_[index_of(mesh)]; }
  const T& operator[](Mesh mesh) const { return values_[index_of(mesh)]; }
  auto begin() { return values_.begin(); }
  auto end() { return values_.end(); }
  auto begin() const { return values_.begin(); }
  auto end() const { return values_.end(); }

 private:
  std::array<T, all_meshes.size()> values_{};
};

}  // namespace slamgw
