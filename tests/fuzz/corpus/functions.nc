L0=sind(30)+atan2d(1,-1)*pow(2,3)%4-rint(-2.5)/sgn(-1) Q1=isnan(0/0) P3=qnrt(-32)
X[L0] Y[Q1] Z[P3]
M30
