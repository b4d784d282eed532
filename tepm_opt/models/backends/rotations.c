/* Levels moved by rotations: what statics and time stepping share. A lane is a level. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define AT(of, k, l) (*(vector *)&(of)[k][l])
enum { ROOM = (NLEV + LANES - 1) / LANES * LANES + 1 }; /* levels from 0 on, in whole vectors from 1 on */
typedef double along[3][ROOM]; /* a vector in space for every level */
typedef struct { along centre, d_centre, turn, link; vector node[(NLEV + LANES - 1) / LANES][NB / 3][3]; } turns; /* room for `move` */

static void cross(const vector *a, const vector *b, vector *c) {
  c[0] = a[1] * b[2] - a[2] * b[1]; c[1] = a[2] * b[0] - a[0] * b[2]; c[2] = a[0] * b[1] - a[1] * b[0];
}

/* A rotation vector with sin(angle) / angle and (1 - cos(angle)) / angle^2, where small by their series. */
typedef struct { vector by[3], s, c; } rotation;

static rotation rotate_by(const vector *by) {
  rotation r = {{by[0], by[1], by[2]}};
  vector square = by[0] * by[0] + by[1] * by[1] + by[2] * by[2], s = (vector){0} + 1, c = s;
  for (int k = 12; k; k -= 2) { /* the last terms are below 1e-17 */
    s = 1 - square * (1. / (k * (k + 1))) * s;
    c = 1 - square * (1. / ((k + 1) * (k + 2))) * c;
  }
  r.s = s; r.c = c / 2;
  for (int lane = 0; lane < LANES; lane++)
    if (square[lane] >= 0.1) {
      double angle = sqrt(square[lane]);
      r.s[lane] = sin(angle) / angle;
      r.c[lane] = (1 - cos(angle)) / square[lane];
    }
  return r;
}

/* A vector v rotated, after its linear change dv less what the rotation accounts for. */
static void rotate(const rotation *r, const vector *v, const vector *dv, vector *rotated) {
  vector turned[3], e[3], once[3], twice[3];
  cross(r->by, v, turned);
  for (int k = 0; k < 3; k++) e[k] = v[k] + dv[k] - turned[k];
  cross(r->by, e, once);
  cross(r->by, once, twice);
  for (int k = 0; k < 3; k++) rotated[k] = e[k] + r->s * once[k] + r->c * twice[k];
}

/* Rotation vector that fits the changes d of the points r best, both about their centres. */
static void fit_rotation(const vector r[][3], const vector d[][3], vector *turn) {
  vector I[3][3] = {}, m[3] = {}, part[3], cofactor[3][3], determinant;
  for (int i = 0; i < NB / 3; i++) {
    vector square = r[i][0] * r[i][0] + r[i][1] * r[i][1] + r[i][2] * r[i][2];
    cross(r[i], d[i], part);
    for (int p = 0; p < 3; p++) {
      m[p] += part[p];
      I[p][p] += square;
      for (int q = 0; q < 3; q++) I[p][q] -= r[i][p] * r[i][q];
    }
  }
  for (int p = 0; p < 3; p++) cross(I[(p + 1) % 3], I[(p + 2) % 3], cofactor[p]);
  determinant = I[0][0] * cofactor[0][0] + I[0][1] * cofactor[0][1] + I[0][2] * cofactor[0][2];
  for (int p = 0; p < 3; p++) turn[p] = (cofactor[0][p] * m[0] + cofactor[1][p] * m[1] + cofactor[2][p] * m[2]) / determinant;
}

/* Coordinate k of the levels from l on, side by side; what goes beyond the last repeats it. */
static inline vector levels_from(double (*x)[NB], int l, int k) {
  vector v;
  for (int lane = 0; lane < LANES; lane++) v[lane] = x[l + lane < NLEV ? l + lane : NLEV][k];
  return v;
}

/* moved = x moved by t times the step, level by level as a rotation plus the rest, so that bending keeps lengths. */
static void move(turns *restrict m, double (*x)[NB], double (*step)[NB], double t, double (*moved)[NB]) {
  for (int k = 0; k < 3; k++) {
    double sum = x[0][k];
    for (int i = 1; i < NB / 3; i++) sum += x[0][3 * i + k];
    m->centre[k][0] = sum / (NB / 3);
    m->d_centre[k][0] = m->turn[k][0] = sum - sum;
  }
  for (int l = 1; l <= NLEV; l += LANES) {
    vector r[NB / 3][3], d[NB / 3][3], turned[3];
    for (int k = 0; k < 3; k++) {
      vector here = {}, d_here = {};
      for (int i = 0; i < NB / 3; i++) {
        here += r[i][k] = levels_from(x, l, 3 * i + k);
        d_here += d[i][k] = t * levels_from(step, l, 3 * i + k);
      }
      here /= NB / 3;
      d_here /= NB / 3;
      for (int i = 0; i < NB / 3; i++) { r[i][k] -= here; d[i][k] -= d_here; }
      AT(m->centre, k, l) = here;
      AT(m->d_centre, k, l) = d_here;
    }
    fit_rotation(r, d, turned);
    rotation of_level = rotate_by(turned);
    for (int k = 0; k < 3; k++) AT(m->turn, k, l) = turned[k];
    for (int i = 0; i < NB / 3; i++) rotate(&of_level, r[i], d[i], m->node[(l - 1) / LANES][i]);
  }
  for (int l = 1; l <= NLEV; l += LANES) {
    vector middle[3], v[3], dv[3], rotated[3];
    for (int k = 0; k < 3; k++) {
      middle[k] = (AT(m->turn, k, l) + AT(m->turn, k, l - 1)) / 2;
      v[k] = AT(m->centre, k, l) - AT(m->centre, k, l - 1);
      dv[k] = AT(m->d_centre, k, l) - AT(m->d_centre, k, l - 1);
    }
    rotation of_link = rotate_by(middle);
    rotate(&of_link, v, dv, rotated);
    for (int k = 0; k < 3; k++) AT(m->link, k, l) = rotated[k];
  }
  memcpy(moved[0], x[0], sizeof *x);
  for (int k = 0; k < 3; k++) {
    double at = m->centre[k][0];
    for (int l = 1; l <= NLEV; l++) {
      at += m->link[k][l];
      for (int i = 0; i < NB / 3; i++) moved[l][3 * i + k] = at + m->node[(l - 1) / LANES][i][k][(l - 1) % LANES];
    }
  }
}
