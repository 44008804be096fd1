// Threads that make one rollout together: a thread block of a GPU, or, compiled for a CPU, a single thread.
//
// All threads run the same statements with the same numbers; only what is given to `each` is shared out among them. Sums
// have one order, whatever else runs on the device: a rollout gives the same bits in every batch.
#pragma once

#include "small.hpp"

// Loops of which some rounds ahead are asked for in memory.
#ifdef __CUDACC_RTC__
#define THINSHELL_AHEAD _Pragma("unroll 4")
#else
#define THINSHELL_AHEAD
#endif

namespace thinshell {

class Team {
 public:
  // `partial`: room for 3 x 32 numbers that all threads see.
  explicit Team(double *partial) : partial_(partial) {}

#ifdef __CUDACC_RTC__
  int thread() const { return threadIdx.x; }
  int threads() const { return blockDim.x; }
  void sync() const { __syncthreads(); }
#else
  int thread() const { return 0; }
  int threads() const { return 1; }
  void sync() const {}
#endif

  // f(k) for all k below `count`; what it writes is seen by all threads afterwards.
  template <class F> void each(int count, F &&f) const {
    for (int k = thread(); k < count; k += threads()) f(k);
    sync();
  }
  // ---- tiles of 8 x 8, by warps (tiles.hpp)
#ifdef __CUDACC_RTC__
  int warp_size() const { return 32; }
  void sync_warp() const { __syncwarp(); }
#else
  int warp_size() const { return 1; }
  void sync_warp() const {}
#endif
  int warp() const { return thread() / warp_size(); }
  int warps() const { return threads() / warp_size(); }
  // Let a number come from global to shared memory; all that a thread asked for have arrived.
  void copy(double *to, const double *from) const {
#ifdef __CUDACC_RTC__
    if (__isShared(to))
      asm volatile("cp.async.ca.shared.global [%0], [%1], 8;" ::"r"(unsigned(__cvta_generic_to_shared(to))), "l"(from));
    else
#endif
      *to = *from;
  }
  void arrived() const {
#ifdef __CUDACC_RTC__
    asm volatile("cp.async.wait_all;" ::: "memory");
#endif
  }
  bool invert(const double *a, double *to, double *also) const;
  void multiply(const double *a, const double *d, double *to, double *also) const;
  template <int MOST, class C> void subtract_products(int count, const double *a, const double *l, C &&c) const;
  static constexpr int stages = 4;
  template <bool TURNED, class Count, class Tile, class Known, class To>
  void sweep(int steps, double *room, int most, Count &&count, Tile &&tile, Known &&known, To &&to) const;

  // Sum of f(k), and of three components of it.
  template <class F> double sum(int count, F &&f) const {
    double own = 0.0;
    for (int k = thread(); k < count; k += threads()) own += f(k);
    return added_up(own);
  }
  template <class F> Vec<double, 3> sum_of_vectors(int count, F &&f) const {
    Vec<double, 3> own{};
    for (int k = thread(); k < count; k += threads()) own += f(k);
    Vec<double, 3> out;
    for (int i = 0; i < 3; ++i) out[i] = added_up(own[i]);
    return out;
  }
  // Largest and smallest of f(k), at least 0 and at most `none`; one that is no number stays.
  template <class F> double most(int count, F &&f) const {
    double own = 0.0;
    for (int k = thread(); k < count; k += threads()) own = larger(own, f(k));
    return largest_of(own);
  }
  template <class F> double least(int count, double none, F &&f) const {
    double own = none;
    for (int k = thread(); k < count; k += threads()) own = smaller(own, f(k));
    return smallest_of(own);
  }

 private:
  static double larger(double a, double b) { return !(b <= a) && a == a ? b : a; }
  static double smaller(double a, double b) { return !(b >= a) && a == a ? b : a; }

  THINSHELL_APART double added_up(double own) const {
    return combined(own, [](double a, double b) { return a + b; });
  }
  THINSHELL_APART double largest_of(double own) const { return combined(own, larger); }
  THINSHELL_APART double smallest_of(double own) const { return combined(own, smaller); }

  template <class Op> double combined(double own, Op op) const {
#ifdef __CUDACC_RTC__
    for (int off = 16; off > 0; off /= 2) own = op(own, __shfl_xor_sync(0xffffffffu, own, off));
    __syncthreads();
    if (threadIdx.x % 32 == 0) partial_[threadIdx.x / 32] = own;
    __syncthreads();
    own = partial_[0];
    for (int w = 1; w < int(blockDim.x) / 32; ++w) own = op(own, partial_[w]);
    __syncthreads();
#else
    (void)op;
#endif
    return own;
  }

  double *partial_;
};

}  // namespace thinshell

#include "tiles.hpp"
