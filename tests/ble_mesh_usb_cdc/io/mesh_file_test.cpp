// SPDX-License-Identifier: Apache-2.0
// The file with the mesh's keys on a disk that fails.
#include "adapters/ble_mesh_usb_cdc/io/mesh_file.hpp"

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>

#include "tests/support/temp_dir.hpp"

namespace {

/// While set, fsync() of a directory fails.
std::atomic<bool> fails_directories = false;

}  // namespace

/// Replaces the C library's function for every file of this process.
extern "C" int fsync(int file) {
  struct stat about {};
  if (fails_directories && ::fstat(file, &about) == 0 && S_ISDIR(about.st_mode)) {
    errno = EIO;
    return -1;
  }
  return static_cast<int>(::syscall(SYS_fsync, file));
}

namespace slamgw::ble {
namespace {

NodeDatabase mesh_with(std::uint8_t key) {
  NodeDatabase mesh;
  mesh.keys.net_key.fill(key);
  return mesh;
}

TEST(MeshFile, StoresNewMeshAgainAfterFailedSyncOfItsDirectory) {
  const test::TempDir directory;
  const MeshFile file(directory.path());
  fails_directories = true;
  EXPECT_NE(file.write(mesh_with(1), /*is_new=*/true), "");
  fails_directories = false;
  EXPECT_EQ(file.write(mesh_with(2), /*is_new=*/true), "");
  EXPECT_EQ((*file.load(0x0001))->keys, mesh_with(2).keys);
}

TEST(MeshFile, DoesNotReplaceAFileByANewMesh) {
  const test::TempDir directory;
  const MeshFile file(directory.path());
  EXPECT_EQ(file.write(mesh_with(1), /*is_new=*/true), "");
  EXPECT_NE(file.write(mesh_with(2), /*is_new=*/true), "");
  EXPECT_EQ((*file.load(0x0001))->keys, mesh_with(1).keys);
}

}  // namespace
}  // namespace slamgw::ble
