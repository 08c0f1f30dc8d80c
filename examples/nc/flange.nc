// Flange: contour with cutter compensation, bore by a helix, six tapped holes
// G52 puts zero into the middle of the stock; the hole pattern turns with G68.
N10 G17 G64 G90 G54
N20 ta40 td40 ts20
N30 M10 VA1 VB40
N40 M98 P1001
N50 M100 VA1                // end mill, radius 5
N60 M03 S6000
N70 M08
N80 G52 X60 Y40

// Outside, radius 30: clockwise with the tool on the left
N100 G00 X0 Y-55
N110 G00 Z5
N120 G01 Z-6 F900
N130 G41 G01 X0 Y-30 F2400  // by the radius of the tool in the spindle
N140 G02 J30
N150 G40 G01 Y-55
N160 G00 Z5

// Bore, radius 12: down by turns of 2 mm, then once around at depth
N200 G00 X7 Y0
N210 G01 Z0 F900
L0 = 0
while (L0 > -6) {
    L0 = L0 - 2
    N220 G03 I-7 Z[L0] F1800
}
N230 G03 I-7
N240 G01 X0
N250 G00 Z5
N260 M05

// Six tapped holes on radius 21, the first one at 15 degrees
N300 M98 P1001
N310 M100 VA2
N320 G68 X0 Y0 R15
N330 S600 F600              // pitch 1 mm
L1 = 0
while (L1 < 6) {
    L2 = 21 * cosd(60 * L1)
    L3 = 21 * sind(60 * L1)
    N340 G00 X[L2] Y[L3]
    N350 G99 G84 X[L2] Y[L3] Z-8 R3 P100
    N360 G80
    L1 = L1 + 1
}
N370 G69
N380 M09
N390 G00 Z100
N400 G52 X0 Y0
N410 G00 X-50 Y-40
N420 M11 VA1
N430 M30
