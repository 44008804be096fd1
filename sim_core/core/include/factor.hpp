// Factorisation of a sparse symmetric matrix within its envelope: A = U^T D^-1 U with rows of U stored from the
// diagonal to the last entry that the factor fills. For narrow meshes, whose nodes are numbered along them.
//
// George & Liu, Computer Solution of Large Sparse Positive Definite Systems, 1981, ch. 4 (envelope); rows of equal
// length, as the three components of a node have, are eliminated together.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace thinshell {

class Envelope {
 public:
  // `last`: last column of each row that has an entry, at least the row itself.
  void lay_out(std::vector<int> last) {
    count_ = int(last.size());
    last_ = std::move(last);
    for (int i = 1; i < count_; ++i)
      if (last_[i - 1] >= i) last_[i] = std::max(last_[i], last_[i - 1]);
    start_.assign(count_ + 1, 0);
    for (int i = 0; i < count_; ++i) start_[i + 1] = start_[i] + (last_[i] - i + 1);
    value_.assign(start_[count_], 0.0);
    inverse_.assign(count_, 0.0);
  }

  int count() const { return count_; }
  std::size_t size() const { return value_.size(); }
  // Place of an entry of the upper triangle, i <= j.
  std::size_t place(int i, int j) const { return start_[i] + (j - i); }
  void clear() { std::fill(value_.begin(), value_.end(), 0.0); }
  double &operator[](std::size_t k) { return value_[k]; }
  double diagonal(int i) const { return value_[start_[i]]; }

  // Factorise in place. `definite`: give up at a pivot that is not positive. False too where a pivot vanishes.
  bool factorise(bool definite) {
    for (int j = 0; j < count_;) {
      const int last = last_[j];
      int group = 1;
      while (group < 4 && j + group < count_ && last_[j + group] == last && j + group <= last) ++group;
      double *row[4];
      for (int g = 0; g < group; ++g) {
        const int i = j + g;
        row[g] = &value_[start_[i]] - i;
        for (int h = 0; h < g; ++h) subtract(row[g], row[h], row[h][i] * inverse_[j + h], i, last);
        const double pivot = row[g][i];
        if (definite ? !(pivot > 0.0) : !(std::abs(pivot) > 0.0)) return false;
        inverse_[i] = 1.0 / pivot;
      }
      int k = j + group;
      if (group == 3)
        for (; k + 2 <= last; k += 3) subtract_three(row, &inverse_[j], k, last);
      for (; k <= last; ++k)
        for (int g = 0; g < group; ++g)
          subtract(&value_[start_[k]] - k, row[g], row[g][k] * inverse_[j + g], k, last);
      j += group;
    }
    return true;
  }

  // Solve in place for one right-hand side.
  void solve(double *b) const {
    for (int j = 0; j < count_; ++j) {
      subtract(b, &value_[start_[j]] - j, b[j] * inverse_[j], j + 1, last_[j]);
    }
    for (int j = count_ - 1; j >= 0; --j) {
      const double *row = &value_[start_[j]] - j;
      double total = 0.0;
#pragma omp simd reduction(+ : total)
      for (int k = j + 1; k <= last_[j]; ++k) total += row[k] * b[k];
      b[j] = (b[j] - total) * inverse_[j];
    }
  }

  // Solve in place for `width` right-hand sides (count, width).
  void solve(double *b, int width) const {
    for (int j = 0; j < count_; ++j) {
      const double *row = &value_[start_[j]] - j, *from = b + std::size_t(j) * width;
      for (int k = j + 1; k <= last_[j]; ++k) {
        subtract(b + std::size_t(k) * width, from, row[k] * inverse_[j], 0, width - 1);
      }
    }
    for (int j = count_ - 1; j >= 0; --j) {
      const double *row = &value_[start_[j]] - j;
      double *to = b + std::size_t(j) * width;
      for (int k = j + 1; k <= last_[j]; ++k) {
        subtract(to, b + std::size_t(k) * width, row[k], 0, width - 1);
      }
      for (int p = 0; p < width; ++p) to[p] *= inverse_[j];
    }
  }

 private:
  static void subtract(double *__restrict to, const double *__restrict row, double factor, int begin, int last) {
    for (int m = begin; m <= last; ++m) to[m] -= factor * row[m];
  }
  // What three rows, with the inverses of their pivots, take from three others.
  void subtract_three(double *const *row, const double *inverse, int k, int last) {
    double f[3][3];
    for (int g = 0; g < 3; ++g)
      for (int i = 0; i < 3; ++i) f[i][g] = row[g][k + i] * inverse[g];
    double *const to[3] = {&value_[start_[k]] - k, &value_[start_[k + 1]] - k - 1, &value_[start_[k + 2]] - k - 2};
    for (int i = 0; i < 2; ++i)
      for (int m = k + i; m < k + 2; ++m)
        to[i][m] -= f[i][0] * row[0][m] + f[i][1] * row[1][m] + f[i][2] * row[2][m];
    multiply_three(to[0], to[1], to[2], row[0], row[1], row[2], f, k + 2, last);
  }
  static void multiply_three(double *__restrict x, double *__restrict y, double *__restrict z,
                             const double *__restrict p, const double *__restrict q, const double *__restrict r,
                             const double (&f)[3][3], int begin, int last) {
    for (int m = begin; m <= last; ++m) {
      const double a = p[m], b = q[m], c = r[m];
      x[m] -= f[0][0] * a + f[0][1] * b + f[0][2] * c;
      y[m] -= f[1][0] * a + f[1][1] * b + f[1][2] * c;
      z[m] -= f[2][0] * a + f[2][1] * b + f[2][2] * c;
    }
  }

  int count_ = 0;
  std::vector<int> last_;
  std::vector<std::size_t> start_;
  std::vector<double> value_, inverse_;
};

}  // namespace thinshell
