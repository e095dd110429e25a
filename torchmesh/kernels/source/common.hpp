// What all loops share: how functions are exported, and which of them are compiled for several instruction sets.
#pragma once

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <thread>
#include <vector>

#if defined(_WIN32)
#define TM_EXPORT extern "C" __declspec(dllexport)
#else
#define TM_EXPORT extern "C" __attribute__((visibility("default")))
#endif

// A function with this mark is compiled once for plain x86-64 and once for AVX2; the loader takes the one that the
// processor has.  Sums are taken in LANES partial sums and products are never fused with sums, so that all of them,
// and other processors, give the same bits.
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(__clang__)
#define TM_DISPATCH __attribute__((target_clones("avx2", "default")))
#else
#define TM_DISPATCH
#endif

#if defined(_MSC_VER)
#define TM_INLINE __forceinline
#define TM_RESTRICT __restrict
#else
#define TM_INLINE inline __attribute__((always_inline))
#define TM_RESTRICT __restrict__
#endif

namespace torchmesh {

constexpr int LANES = 8;

// Runs task(i) for i = 0 ... count - 1 on so many threads.  Each task depends on nothing that another writes.
template <class Task>
void in_threads(std::int64_t count, int threads, const Task& task) {
    threads = int(std::min<std::int64_t>(threads, count));
    if (threads < 2) {
        for (std::int64_t i = 0; i < count; ++i) task(i);
        return;
    }
    std::atomic<std::int64_t> next{0};
    auto work = [&] {
        for (std::int64_t i; (i = next.fetch_add(1)) < count;) task(i);
    };
    std::vector<std::thread> others;
    for (int t = 1; t < threads; ++t) others.emplace_back(work);
    work();
    for (auto& other : others) other.join();
}

}  // namespace torchmesh
