// Factorisation A = L D L^T of a banded matrix by a thread block: tiles of 8 x 8, the window of the band that a column
// updates in shared memory where that has room, L and the inverses of the blocks of D in global memory.
//
// Right-looking. While one warp updates and inverts the next tile of the diagonal, the others update the rest and bring the
// rows that the next column reaches into the window. Products of tiles run on the tensor cores for doubles; a thread has two entries of a tile that
// stand next to each other, and the order in which products are summed is that of the tensor cores' fragments.
#pragma once

#include "plan.hpp"
#include "team.hpp"

namespace thinshell {

class BandFactor {
 public:
  // `window`: room for (reach + 1) (reach + 2) / 2 tiles; in shared memory `panel`: for reach + 2 tiles, a number
  // and four integers a tile row, and `area`, which
  // may be that of the window: for two tiles of vectors a tile row and `stages` times reach - 1 tiles; `factor`: for all
  // tiles of L, the inverse of D in place of each diagonal one.
  BandFactor(const Team &team, const Plan &plan, double *window, double *panel, double *area, double *factor)
      : team_(team), p_(plan), ring_(int(plan.reach) + 1), window_(window), panel_(panel), area_(area), pivot_(panel + 64 * plan.reach),
        refused_(pivot_ + 128), factor_(factor) {
    const int tiles = int(plan.tiles);
    int32_t *table = reinterpret_cast<int32_t *>(refused_ + 1);
    last_ = table;
    first_ = table + tiles;
    panel_start_ = table + 2 * tiles;
    entry_start_ = table + 3 * tiles;
    team_.each(tiles, [&](int k) {
      table[k] = plan.last[k];
      table[tiles + k] = plan.first[k];
      table[2 * tiles + k] = plan.panel_start[k];
      table[3 * tiles + k] = plan.entry_start[k];
    });
  }

  // Of a matrix by the values of its blocks, with a shift of the diagonal; false where it is not positive definite.
  THINSHELL_APART bool factorise(const double *values, double shift) {
    BandFactor own = *this;  // the members of a copy stay in registers
    return own.eliminate(values, shift);
  }

  // Solve in place for what the caller has written to `rhs()`, in the order of the unknowns, with zeros up to the last tile.
  THINSHELL_APART void solve() {
    BandFactor own = *this;
    own.substitute();
  }
  double *rhs() { return area_; }
  const double *answer() const { return area_ + 8 * p_.tiles; }

 private:
  bool eliminate(const double *values, double shift) {
    const int count = int(p_.tiles);
    const bool alone = team_.warps() == 1;
    for (int i = 0; i <= last_[0]; ++i) load(i, values, 0, 0);
    team_.arrived();
    team_.each(1, [&](int) { *refused_ = 0.0; });
    if (team_.warp() == 0) invert(0, 0, shift);
    Pending coming;
    const int begin = alone ? 0 : team_.warp_size();  // the threads that bring rows in
    if (count > 1 && team_.thread() >= begin) ask(coming, last_[0] + 1, last_[1], begin);
    team_.sync();
    for (int j = 0, place = 0; j < count; ++j) {
      if (*refused_ != 0.0) return false;
      const int last = last_[j], height = last - j;
      double *out = factor_ + 64 * (long long)(panel_start_[j]);
      for (int k = team_.warp(); k < height; k += team_.warps())
        team_.multiply(tile(after(place, k + 1), place), pivot_ + 64 * (j % 2), panel_ + 64 * k, out + 64 * (k + 1));
      if (j + 1 == count) break;
      const int next = after(place, 1), until = last_[j + 1];
      if (height == 0) {  // the next tile of the diagonal has not come yet
        team_.sync();
        if (team_.thread() >= begin) bring(coming, values, next, begin);
        team_.arrived();
      }
      team_.sync();
      if (team_.thread() >= begin) {
        if (height > 0) bring(coming, values, next, begin);
        for (int i = last + 2; i <= until; ++i) load(i, values, next, begin);
        if (j + 2 < count) ask(coming, until + 1, last_[j + 2], begin);
        const int by = alone ? 1 : team_.warps() - 1;
        int unit = alone ? 0 : team_.warp() - 1;
        for (int i = 1; i < height; ++i) {
          for (; 6 * unit <= i; unit += by) update(place, i, 6 * unit);
          unit -= i / 6 + 1;
        }
        team_.arrived();
      }
      if (team_.warp() == 0) {
        if (height > 0) update(place, 0, 0);
        team_.sync_warp();
        invert(j + 1, next, shift);
      }
      team_.sync();
      place = next;
    }
    team_.sync();
    return true;
  }

  void substitute() {
    const int count = int(p_.tiles), most = int(p_.reach) - 1;
    double *b = area_, *z = area_ + 8 * count, *room = area_ + 16 * count;
    // b <- L^-1 b, a tile column after the other
    team_.sweep<false>(
        count - 1, room, most, [&](int s) { return last_[s] - s; },
        [&](int s, int t) { return tile_of_l(panel_start_[s] + 1 + t); }, [&](int s) { return b + 8 * s; },
        [&](int s, int t) { return b + 8 * (s + 1 + t); });
    team_.each(8 * count, [&](int k) {
      const double *d = tile_of_l(panel_start_[k / 8]) + 8 * (k % 8);
      double total = 0.0;
      for (int m = 0; m < 8; ++m) total += d[m] * b[(k & ~7) + m];
      z[k] = total;
    });
    // z <- L^-T z: what is known of a tile row is taken from all before it that it reaches
    team_.sweep<true>(
        count - 1, room, most, [&](int s) { return count - 1 - s - first_[count - 1 - s]; },
        [&](int s, int t) {
          const int i = count - 1 - s, j = first_[i] + t;
          return tile_of_l(panel_start_[j] + i - j);
        },
        [&](int s) { return z + 8 * (count - 1 - s); }, [&](int s, int t) { return z + 8 * (first_[count - 1 - s] + t); });
  }

  const double *tile_of_l(int k) const { return factor_ + 64 * (long long)(k); }
  // The place in the ring that is `steps` tiles after another.
  int after(int place, int steps) const { return place + steps < ring_ ? place + steps : place + steps - ring_; }
  double *tile(int a, int b) const {
    const int high = a > b ? a : b, low = a > b ? b : a;
    return window_ + 64 * (high * (high + 1) / 2 + low);
  }

  // Where entries of a tile row that a thread is to bring are among the values.
  struct Pending {
    static constexpr int most = 5;
    int row = -1, at[most];
  };
  const int32_t *map(int i) const { return p_.entry + 64 * (long long)(entry_start_[i]); }
  // Place of an entry of a row, the first of whose columns is at `place` in the ring.
  double *place_of(int rows, int place, int k) const { return tile(after(place, rows), after(place, k / 64)) + k % 64; }

  // Look up the tile row `i`, if that is not beyond `last`.
  void ask(Pending &to, int i, int last, int begin) const {
    to.row = i <= last ? i : -1;
    if (to.row < 0) return;
    const int count = 64 * (i - first_[i] + 1), by = team_.threads() - begin, own = team_.thread() - begin;
    const int32_t *from = map(i) + own;
    THINSHELL_UNROLL for (int u = 0; u < Pending::most; ++u) to.at[u] = own + u * by < count ? from[u * by] : 0;
  }
  // Let it come into the window, with what a thread could not look up of it; `place`: of the column that reaches it first.
  void bring(const Pending &from, const double *values, int place, int begin) const {
    if (from.row < 0) return;
    const int rows = from.row - first_[from.row], count = 64 * (rows + 1), by = team_.threads() - begin;
    int k = team_.thread() - begin;
    THINSHELL_UNROLL for (int u = 0; u < Pending::most; ++u, k += by)
      if (k < count) team_.copy(place_of(rows, place, k), values + from.at[u]);
    for (; k < count; k += by) team_.copy(place_of(rows, place, k), values + map(from.row)[k]);
  }
  // Both at once, by the threads from `begin` on.
  void load(int i, const double *values, int place, int begin) const {
    const int rows = i - first_[i], count = 64 * (rows + 1);
    for (int k = team_.thread() - begin; k < count; k += team_.threads() - begin)
      team_.copy(place_of(rows, place, k), values + map(i)[k]);
  }

  // The inverse of the diagonal tile of a column, by one warp.
  void invert(int j, int place, double shift) {
    double *at = tile(place, place);
    if (shift != 0.0)
      for (int k = team_.thread(); k < 8 && 8 * j + k < p_.unknowns; k += team_.warp_size()) at[9 * k] += shift;
    team_.sync_warp();
    if (team_.invert(at, pivot_ + 64 * (j % 2), factor_ + 64 * (long long)(panel_start_[j]))) *refused_ = 1.0;
  }

  // Take a column's part from up to six tiles of the row `i` below it, from the tile `first` on: C_ik -= A_i L_k^T.
  void update(int place, int i, int first) {
    const int row = after(place, i + 1), count = i + 1 - first < 6 ? i + 1 - first : 6;
    team_.subtract_products<6>(count, tile(row, place), panel_ + 64 * first,
                               [&](int k) { return tile(row, after(place, first + k + 1)); });
  }

  const Team &team_;
  const Plan &p_;
  int ring_;
  double *window_, *panel_, *area_, *pivot_, *refused_, *factor_;
  const int32_t *last_, *first_, *panel_start_, *entry_start_;  // of the plan, in shared memory
};

}  // namespace thinshell
