/* Levels moved by rotations: what statics and time stepping share. */
static void cross(const real *a, const real *b, real *c) {
  c[0] = a[1] * b[2] - a[2] * b[1]; c[1] = a[2] * b[0] - a[0] * b[2]; c[2] = a[0] * b[1] - a[1] * b[0];
}

/* A rotation vector with sin(angle) / angle and (1 - cos(angle)) / angle^2, where small by their series. */
typedef struct { real by[3], s, c; } rotation;

static rotation rotate_by(const real *by) {
  rotation r = {{by[0], by[1], by[2]}};
  real square = by[0] * by[0] + by[1] * by[1] + by[2] * by[2], s = (real){0} + 1, c = (real){0} + 1;
  for (int k = 12; k; k -= 2) { /* the last terms are below 1e-17 */
    s = 1 - square * (1. / (k * (k + 1))) * s;
    c = 1 - square * (1. / ((k + 1) * (k + 2))) * c;
  }
  r.s = s; r.c = c / 2;
  if (!any(WHERE(square >= 0.1))) return r;
  for (int lane = 0; lane < WIDTH; lane++)
    if (LANE(square, lane) >= 0.1) {
      double angle = sqrt(LANE(square, lane));
      LANE(r.s, lane) = sin(angle) / angle;
      LANE(r.c, lane) = (1 - cos(angle)) / LANE(square, lane);
    }
  return r;
}

/* target += a vector v rotated, after its linear change dv less what the rotation accounts for. */
static void add_rotated(real *target, const rotation *r, const real *v, const real *dv) {
  real turned[3], e[3], once[3], twice[3];
  cross(r->by, v, turned);
  for (int k = 0; k < 3; k++) e[k] = v[k] + dv[k] - turned[k];
  cross(r->by, e, once);
  cross(r->by, once, twice);
  for (int k = 0; k < 3; k++) target[k] += e[k] + r->s * once[k] + r->c * twice[k];
}

/* Rotation vector that fits the changes d of the points r best, both about their centres. */
static void fit_rotation(real r[][3], real d[][3], real *turn) {
  real I[3][3] = {}, m[3] = {}, part[3], cofactor[3][3], determinant;
  for (int i = 0; i < NB / 3; i++) {
    real square = r[i][0] * r[i][0] + r[i][1] * r[i][1] + r[i][2] * r[i][2];
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

/* moved = x moved by t times the step, level by level as a rotation plus the rest, so that bending keeps lengths. */
static void move(real (*x)[NB], real (*step)[NB], double t, real (*moved)[NB]) {
  real before[3] = {}, d_before[3] = {}, turn_before[3] = {}, centre[3];
  for (int k = 0; k < 3; k++) {
    for (int i = 0; i < NB / 3; i++) before[k] += x[0][3 * i + k] / (NB / 3);
    centre[k] = before[k];
  }
  memcpy(moved[0], x[0], sizeof *x);
  for (int l = 1; l <= NLEV; l++) {
    real here[3] = {}, d_here[3] = {}, turn[3], middle[3], r[NB / 3][3], d[NB / 3][3], link[3], d_link[3];
    for (int k = 0; k < 3; k++) {
      for (int i = 0; i < NB / 3; i++) { here[k] += x[l][3 * i + k] / (NB / 3); d_here[k] += t * step[l][3 * i + k] / (NB / 3); }
      for (int i = 0; i < NB / 3; i++) { r[i][k] = x[l][3 * i + k] - here[k]; d[i][k] = t * step[l][3 * i + k] - d_here[k]; }
    }
    fit_rotation(r, d, turn);
    for (int k = 0; k < 3; k++) {
      middle[k] = (turn[k] + turn_before[k]) / 2;
      link[k] = here[k] - before[k];
      d_link[k] = d_here[k] - d_before[k];
    }
    rotation of_link = rotate_by(middle), of_level = rotate_by(turn);
    add_rotated(centre, &of_link, link, d_link);
    for (int i = 0; i < NB / 3; i++) {
      for (int k = 0; k < 3; k++) moved[l][3 * i + k] = centre[k];
      add_rotated(moved[l] + 3 * i, &of_level, r[i], d[i]);
    }
    memcpy(before, here, sizeof before); memcpy(d_before, d_here, sizeof before); memcpy(turn_before, turn, sizeof before);
  }
}
