// Plate: contour, pocket and engraved mark, two tools
// Stock 120 x 80 x 20 mm, clamped at G54; Z0 is its upper face.
N10 G17 G64 G90 G54
N20 ta60 td60 ts30
N30 M10 VA1 VB40            // close clamp 1 with 40 bar
N40 M98 P1001               // to the tool change position
N50 M100 VA1                // end mill, diameter 10
N60 M03 S6000
N70 M08

/* Contour with chamfered corners,
   in two steps of depth. */
N100 G00 X-12 Y-6
N110 G00 Z5
N120 G01 Z-4 F900
N130 G01 Y70 F2400
N140 X10 Y86
N150 X110
N160 X126 Y70
N170 Y10
N180 X110 Y-6
N190 X10
N200 X-6 Y10
N210 Z-8 F900
N220 Y70 F2400
N230 X10 Y86
N240 X110
N250 X126 Y70
N260 Y10
N270 X110 Y-6
N280 X10
N290 G09 X-6 Y10
N300 G00 Z5

// Pocket 40 x 30, from the middle outward
N400 G00 X60 Y40
N410 G01 Z-3 F600
N420 G91 F1800
N430 X5
N440 Y5
N450 X-10
N460 Y-10
N470 X15
N480 Y15
N490 X-20
N500 Y-20
N510 X25
N520 Y20
N530 X-25
N540 G90
N550 G00 Z5
N560 M05
N570 M01                    // optional stop: look at the contour

// Mark
N600 M98 P1001
N610 M100 VA3               // engraver
N620 M03 S9000
N630 G61
N640 G00 X20 Y60
N650 G00 Z2
N660 G01 Z-0.3 F300
N670 X20 Y70 F1200
N680 X30 Y60
N690 X30 Y70
/1 N700 X40 Y70             // block skip 1 leaves the bar out
N710 G00 Z5
N720 G64
N730 M05
N740 M09
N750 G00 Z100
N760 G00 X-50 Y-40
N770 M11 VA1                // release clamp 1
N780 M30
