if (L1==1) { X1 } else if(L2<3||!(L4>=5)) X2 else { X3 }
while(L1<3) { L1=L1+1 X[L1] if(L1==2) break }
do X1 while(1==2)
switch(L1) { case 1: X1 break case -2: default: X2 }
M30
