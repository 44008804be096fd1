// What warps do with tiles of 8 x 8 in row order; on a CPU the same in loops. A thread of a warp has two entries of a tile
// next to each other, 2 lane and 2 lane + 1, as fragments of the tensor cores have them.
#pragma once

#include "team.hpp"

namespace thinshell {

#ifdef __CUDACC_RTC__

// c += a b^T of one tile, where the columns of a and the columns of b are taken even ones first.
inline void fused(double2 &c, const double2 &a, const double2 &b) {
  asm volatile("mma.sync.aligned.m8n8k4.row.col.f64.f64.f64.f64 {%0, %1}, {%2}, {%3}, {%0, %1};"
               : "+d"(c.x), "+d"(c.y) : "d"(a.x), "d"(b.x));
  asm volatile("mma.sync.aligned.m8n8k4.row.col.f64.f64.f64.f64 {%0, %1}, {%2}, {%3}, {%0, %1};"
               : "+d"(c.x), "+d"(c.y) : "d"(a.y), "d"(b.y));
}
inline double2 pair_of(const double *tile, int lane) { return reinterpret_cast<const double2 *>(tile)[lane]; }
inline void set_pair(double *tile, int lane, const double2 &v) { reinterpret_cast<double2 *>(tile)[lane] = v; }

#endif

// Into `to` and `also` the inverse of a symmetric tile of which the lower half is given, by one warp (Gauss-Jordan); true
// where a pivot is not positive.
inline bool Team::invert(const double *a, double *to, double *also) const {
  bool refused = false;
#ifdef __CUDACC_RTC__
  const int lane = threadIdx.x % 32, row = lane / 4, column = 2 * (lane % 4);
  double x = row >= column ? a[8 * row + column] : a[8 * column + row];
  double y = row > column ? a[8 * row + column + 1] : a[8 * column + 8 + row];
#pragma unroll
  for (int s = 0; s < 8; ++s) {
    const double mine = s % 2 ? y : x;
    const double pivot = __shfl_sync(0xffffffffu, mine, 4 * s + s / 2);
    const double p = __shfl_sync(0xffffffffu, x, 4 * s + lane % 4), q = __shfl_sync(0xffffffffu, y, 4 * s + lane % 4);
    const double across = __shfl_sync(0xffffffffu, mine, (lane & ~3) + s / 2);
    refused = refused || !(pivot > 0.0);
    const double by = 1.0 / pivot, share = across * by;
    if (row == s) {
      x = column == s ? by : p * by;
      y = column + 1 == s ? by : q * by;
    } else {
      x = column == s ? -share : x - share * p;
      y = column + 1 == s ? -share : y - share * q;
    }
  }
  set_pair(to, lane, {x, y});
  set_pair(also, lane, {x, y});
#else
  double m[64];
  for (int k = 0; k < 64; ++k) m[k] = k / 8 >= k % 8 ? a[k] : a[8 * (k % 8) + k / 8];
  for (int s = 0; s < 8; ++s) {
    refused = refused || !(m[9 * s] > 0.0);
    const double by = 1.0 / m[9 * s];
    double line[8];
    for (int k = 0; k < 8; ++k) line[k] = m[8 * s + k];
    for (int i = 0; i < 8; ++i) {
      const double share = m[8 * i + s] * by;
      for (int k = 0; k < 8; ++k)
        if (i == s) m[8 * i + k] = k == s ? by : line[k] * by;
        else m[8 * i + k] = k == s ? -share : m[8 * i + k] - share * line[k];
    }
  }
  for (int k = 0; k < 64; ++k) to[k] = also[k] = m[k];
#endif
  return refused;
}

// Into `to` and `also` the product a d of a tile and a symmetric one, by one warp.
inline void Team::multiply(const double *a, const double *d, double *to, double *also) const {
#ifdef __CUDACC_RTC__
  const int lane = threadIdx.x % 32;
  double2 found = {0.0, 0.0};
  fused(found, pair_of(a, lane), pair_of(d, lane));
  set_pair(to, lane, found);
  set_pair(also, lane, found);
#else
  for (int r = 0; r < 8; ++r)
    for (int s = 0; s < 8; ++s) {
      double total = 0.0;
      for (int m = 0; m < 8; ++m) total += a[8 * r + m] * d[8 * s + m];
      to[8 * r + s] = also[8 * r + s] = total;
    }
#endif
}

// c(k) -= a l_k^T for `count` tiles l_k, at most MOST, one after the other in memory, by one warp.
template <int MOST, class C> void Team::subtract_products(int count, const double *a, const double *l, C &&c) const {
#ifdef __CUDACC_RTC__
  const int lane = threadIdx.x % 32;
  double2 minus = pair_of(a, lane), found[MOST], by[MOST];
  double *at[MOST];
  minus.x = -minus.x;
  minus.y = -minus.y;
#pragma unroll
  for (int i = 0; i < MOST; ++i) {
    const int k = i < count ? i : count - 1;
    at[i] = c(k);
    found[i] = pair_of(at[i], lane);
    by[i] = pair_of(l + 64 * k, lane);
  }
#pragma unroll
  for (int i = 0; i < MOST; ++i) fused(found[i], minus, by[i]);
#pragma unroll
  for (int i = 0; i < MOST; ++i)
    if (i < count) set_pair(at[i], lane, found[i]);
#else
  for (int k = 0; k < count; ++k) {
    double *at = c(k);
    for (int r = 0; r < 8; ++r)
      for (int s = 0; s < 8; ++s)
        for (int m = 0; m < 8; ++m) at[8 * r + s] -= a[8 * r + m] * l[64 * k + 8 * s + m];
  }
#endif
}

// For all steps s, one after the other: to(s, t) -= tile(s, t) known(s), 8 numbers each, or by the transposed tile, of
// count(s) tiles. A GPU fetches them some steps before into `room`, shared memory for `stages` times `most` tiles.
template <bool TURNED, class Count, class Tile, class Known, class To>
void Team::sweep(int steps, double *room, int most, Count &&count, Tile &&tile, Known &&known, To &&to) const {
#ifdef __CUDACC_RTC__
  const auto fetch = [&](int s) {
    if (s < steps) {
      double *at = room + 64 * most * (s % stages);
      const int chunks = 32 * count(s);
      for (int c = threadIdx.x; c < chunks; c += blockDim.x)
        asm volatile("cp.async.cg.shared.global [%0], [%1], 16;" ::"r"(unsigned(__cvta_generic_to_shared(at + 2 * c))),
                     "l"(tile(s, c / 32) + 2 * (c % 32)));
    }
    asm volatile("cp.async.commit_group;");
  };
  for (int s = 0; s < stages - 1; ++s) fetch(s);
  for (int s = 0; s < steps; ++s) {
    asm volatile("cp.async.wait_group %0;" ::"n"(stages - 2));
    __syncthreads();
    fetch(s + stages - 1);
    const double *at = room + 64 * most * (s % stages), *v = known(s);
    const int rows = 8 * count(s);
    for (int k = threadIdx.x; k < rows; k += blockDim.x) {
      const int r = k % 8;
      double even = 0.0, odd = 0.0;
#pragma unroll
      for (int m = 0; m < 8; m += 2) {  // rows begin at different columns, in banks of their own
        const int p = TURNED ? m : (m + r) % 8, q = TURNED ? m + 1 : (m + 1 + r) % 8;
        even += (TURNED ? at[(k & ~7) * 8 + 8 * p + r] : at[8 * k + p]) * v[p];
        odd += (TURNED ? at[(k & ~7) * 8 + 8 * q + r] : at[8 * k + q]) * v[q];
      }
      to(s, k / 8)[r] -= even + odd;
    }
  }
  __syncthreads();
#else
  (void)room;
  (void)most;
  for (int s = 0; s < steps; ++s)
    for (int k = 0; k < 8 * count(s); ++k) {
      const double *at = tile(s, k / 8), *v = known(s);
      double total = 0.0;
      for (int m = 0; m < 8; ++m) total += (TURNED ? at[8 * m + k % 8] : at[8 * (k % 8) + m]) * v[m];
      to(s, k / 8)[k % 8] -= total;
    }
#endif
}

}  // namespace thinshell
