/* The page of needles contains parts of d3-array, d3-path and d3-shape.

Copyright 2010-2026 Mike Bostock

Permission to use, copy, modify, and/or distribute this software for any purpose
with or without fee is hereby granted, provided that the above copyright notice
and this permission notice appear in all copies.

THE SOFTWARE IS PROVIDED "AS IS" AND THE AUTHOR DISCLAIMS ALL WARRANTIES WITH
REGARD TO THIS SOFTWARE INCLUDING ALL IMPLIED WARRANTIES OF MERCHANTABILITY AND
FITNESS. IN NO EVENT SHALL THE AUTHOR BE LIABLE FOR ANY SPECIAL, DIRECT,
INDIRECT, OR CONSEQUENTIAL DAMAGES OR ANY DAMAGES WHATSOEVER RESULTING FROM LOSS
OF USE, DATA OR PROFITS, WHETHER IN AN ACTION OF CONTRACT, NEGLIGENCE OR OTHER
TORTIOUS ACTION, ARISING OUT OF OR IN CONNECTION WITH THE USE OR PERFORMANCE OF
THIS SOFTWARE. */
"use strict";(()=>{var __getOwnPropNames=Object.getOwnPropertyNames;var __esm=(fn,res,err)=>function(){if(err)throw err[0];try{return fn&&(res=(0,fn[__getOwnPropNames(fn)[0]])(fn=
0)),res}catch(e){throw err=[e],e}};function check(fault){if(fault)throw new TypeError(`the kernel refuses a problem: ${FAULTS[Number(fault)]}`)}function makeProblem(heap,fields,arrays){
let addresses=ARRAYS.map(name=>arrays[name]?heap.put(arrays[name]):0),at=heap.structure(SIZES.map(name=>fields[name]),
NUMBERS.map(name=>Number(fields[name])),addresses),sizes=heap.take(24);check(heap.call.nf_check(at,sizes));let[
room,maxPoints]=heap.integers(sizes,2),places=Object.fromEntries(ARRAYS.map((name,i)=>[name,addresses[i]]));return{
at,sizes,fields,arrays:places,room:Number(room),maxPoints:Number(maxPoints)}}function rewrite(heap,problem,arrays){
for(let[name,array3]of Object.entries(arrays))heap.put(array3,problem.arrays[name]);check(heap.call.nf_check(problem.
at,problem.sizes))}function makeShapes(heap,{fields,room},points){let[sets,columns2,planes]=["sets","columns",
"planes"].map(name=>Number(fields[name])),values={x:sets*room,u:planes*sets*room,slope:planes*sets*room,constraints:(1+
planes)*sets*points,track:2*planes*sets*points},derivatives={u_by:values.u,slope_by:values.slope,constraints_by:planes*
sets*points,track_by:planes*sets*points},counts=Object.fromEntries([...Object.entries({...values,status:sets,passes:sets,
nodes:1}),...Object.entries(derivatives).map(([name,count2])=>[name,count2*columns2])]),places=Object.fromEntries(
Object.entries(counts).map(([name,count2])=>[name,count2?heap.take(8*count2):0]));return{...places,places,counts,
room,planes,at:heap.structure([room,points],[],Object.values(places))}}var STATUS,FAULTS,SIZES,NUMBERS,ARRAYS,
compile,Heap,init_memory=__esm({"needlefit/mechanics/native/memory.js"(){"use strict";STATUS=["converged","ove\
r-compressed","not converged","non-finite"],FAULTS=["","size","mesh","stop","guides","column","output","points"],
SIZES="planes sets layers shapes terms numbers stop_count bevels inputs rays guides columns max_iterations".split(
" "),NUMBERS="length first_cell spacing element part tangent tolerance deepest".split(" "),ARRAYS="boundaries \
stops rigidity mu thickness friction law law_by turn base before_first within_first before within held_tip gui\
de_x turn_by column_of guide_columns".split(" "),compile=bytes=>WebAssembly.compile(bytes),Heap=class _Heap{constructor(instance){
this.call=instance.exports,this.memory=instance.exports.memory,this.top=this.memory.buffer.byteLength}static async make(kernel){
return new _Heap(await WebAssembly.instantiate(kernel,{}))}take(bytes){let at=Math.ceil(this.top/64)*64;this.top=
at+Number(bytes);let missing=this.top-this.memory.buffer.byteLength;return missing>0&&this.memory.grow(Math.ceil(
missing/65536)),at}put(array3,at=this.take(array3.byteLength)){return new Uint8Array(this.memory.buffer,at).set(
new Uint8Array(array3.buffer,array3.byteOffset,array3.byteLength)),at}borrow(work){let{top}=this;try{return work()}finally{
this.top=top}}evaluate(which,x2){return this.borrow(()=>{let[at,out]=[this.put(Float64Array.of(x2)),this.take(
8)];return this.call.nf_function(BigInt(which),1n,at,out),this.floats(out,1)[0]})}floats(at,count2){return new Float64Array(
this.memory.buffer,at,count2)}integers(at,count2){return new BigInt64Array(this.memory.buffer,at,count2)}structure(integers,numbers,addresses){
let at=this.take(8*(integers.length+numbers.length)+4*addresses.length);return this.put(BigInt64Array.from(integers,
BigInt),at),this.put(Float64Array.from(numbers),at+8*integers.length),this.put(Uint32Array.from(addresses),at+
8*(integers.length+numbers.length)),at}}}});function checkInputs({length,element:element2},{guides},depth){if(!(depth>=0&&depth<length&&depth<=MAX_ELEMENTS*
element2))throw new RangeError(`the needle cannot be ${depth} mm deep`);if(guides.length>MAX_GUIDES)throw new RangeError(
`${guides.length} guides; there may be ${MAX_GUIDES}`);let ends=[depth-length,...guides.map(({x:x2})=>x2)];if(ends.
some((x2,i)=>i>0&&!(x2>ends[i-1])))throw new RangeError(`base and guides stand at ${ends} mm; they must increa\
se`)}function findToward(heap,{side,roll:roll2}){if(roll2===0)return[side,0];let quarters=Math.floor(roll2/90+
.5),rest=(roll2-90*quarters)*(Math.PI/180),[z,y2]=[3,4].map(which=>side*heap.evaluate(which,rest));return[[y2,
z],[-z,y2],[-y2,-z],[z,-y2]][(quarters%4+4)%4]}function listGuides(guides,planes){let listed=new Float64Array(
(1+2*planes)*MAX_GUIDES);return listed.set(guides.flatMap(({x:x2,y:y2,slope:slope4})=>[x2,...listHeld(y2,slope4,
0,planes)])),listed}function packInputs(heap,{bevel,base,guides,tip},model,planes){let[before,within2]=[guides.
filter(({x:x2})=>x2<0),guides.filter(({x:x2})=>x2>=0)],toward=findToward(heap,bevel).slice(0,planes);return{turn:Float64Array.
from(toward,part2=>part2*bevel.strength/(model.pathAngle?1:model.spacing)),base:Float64Array.from([base.y,base.
slope,base.stageSlope,0,0,0].slice(0,3*planes)),before_first:BigInt64Array.of(0n,BigInt(before.length)),within_first:BigInt64Array.
of(0n,BigInt(within2.length)),before:listGuides(before,planes),within:listGuides(within2,planes),held_tip:Float64Array.
from(tip?listHeld(tip.y,tip.slope,tip.z??0,planes):Array(2*planes).fill(NaN))}}function pack(heap,model,inputs,planes,rays){
let{boundaries,rigidity,mu,thickness,friction,law}=model,arrays=Object.entries({boundaries,rigidity:[rigidity],
mu,thickness,friction,law});return makeProblem(heap,{planes,rays,sets:1,layers:mu.length,shapes:1,terms:model.
terms,numbers:law.length/mu.length,stop_count:1,bevels:1,inputs:1,guides:MAX_GUIDES,columns:0,max_iterations:model.
maxIterations,length:model.length,first_cell:model.firstCell,spacing:model.spacing,element:model.element,part:model.
pathAngle?LINEAR_CUT:model.switch,tangent:model.tangent,tolerance:model.tolerance,deepest:findDeepest(model)},
{...Object.fromEntries(arrays.map(([name,values])=>[name,Float64Array.from(values)])),stops:new Uint8Array(STOP_BYTES),
...packInputs(heap,inputs,model,planes)})}function readShape(heap,{places,planes,room},points){let[status,nodes]=[
"status","nodes"].map(name=>Number(heap.integers(places[name],1)[0])),read=(name,count2,plane=0)=>heap.floats(
places[name]+8*plane*room,count2).slice(),readPlanes=name=>planes===1?read(name,nodes):Float64Array.of(...read(
name,nodes),...read(name,nodes,1)),x2=read("x",nodes);return{status:STATUS[status],depth:x2[nodes-1],planes,x:x2,
u:readPlanes("u"),slope:readPlanes("slope"),constraints:read("constraints",(1+planes)*points),track:read("trac\
k",2*planes*points)}}function layOut(heap,base,{model,inputs,planes,rays},old){let{call}=heap;heap.top=base;let problem=pack(
heap,model,inputs,planes,rays),[shapes,done]=[makeShapes(heap,problem,problem.maxPoints),heap.take(24)];call.nf_session_memory(
problem.at,done);let[fixedBytes,bytes,scratchBytes]=heap.integers(done,3).map(BigInt),[fixed,state,next,scratch]=[
fixedBytes,bytes,bytes,scratchBytes].map(size=>heap.take(size));return call.nf_session_begin(problem.at,fixed,
state,scratch),old&&call.nf_session_copy(old.problem.at,problem.at,fixed,old.state,old.scratch,state,scratch),
{problem,shapes,done,fixed,state,next,scratch,bytes:Number(bytes),end:heap.top}}var SAME_DEPTH,MAX_ELEMENTS,MAX_GUIDES,
LINEAR_CUT,MAX_RAYS,STOP_BYTES,MOVE_BYTES,POSITION_BYTES,isPlanar,listHeld,findDeepest,Session,init_needle=__esm(
{"needlefit/mechanics/native/needle.js"(){"use strict";init_memory();SAME_DEPTH=1e-9,MAX_ELEMENTS=5e3,MAX_GUIDES=
50,LINEAR_CUT=-1,MAX_RAYS=15e3,STOP_BYTES=48,MOVE_BYTES=24,POSITION_BYTES=64;isPlanar=(heap,{bevel,tip})=>findToward(
heap,bevel)[1]===0&&!tip?.z,listHeld=(y2,slope4,z,planes)=>[y2,slope4??NaN,z,slope4===null?NaN:0].slice(0,2*planes);
findDeepest=({length,element:element2})=>Math.min(length,MAX_ELEMENTS*element2);Session=class _Session{static async begin(kernel,model,inputs){
return new _Session(await Heap.make(kernel),model,inputs)}failed=!1;planes=1;depth=0;rays=0;numbers=new Map;known=[];shape=null;memory=null;constructor(heap,model,inputs){
this.heap=heap,this.start=heap.top,this.model=model,this.inputs=inputs,this.#begin(model,inputs)}#begin(model,inputs,planes=model.
spatial||!isPlanar(this.heap,inputs)?2:this.planes){this.#layOut({model,inputs,planes,depth:0,rays:Math.ceil(findDeepest(
model)/model.spacing)}),this.go(0,inputs)}#layOut(fields){Object.assign(this,fields),this.memory=layOut(this.heap,
this.start,this)}go(depth,given){let{heap,inputs:before}=this,inputs={...given,guides:given.guides.toSorted((one,other)=>one.
x-other.x)};if(checkInputs(this.model,inputs,depth),this.planes===1&&!isPlanar(heap,inputs)){let path3=this.path();
this.#begin(this.model,path3[0].inputs,2);for(let one of path3)this.go(one.depth,one.inputs)}this.inputs=inputs,
rewrite(heap,this.memory.problem,packInputs(heap,inputs,this.model,this.planes));let numbers=this.#count(inputs),
advance=()=>{let{problem,shapes,done,fixed,state:state2,next:next2,scratch}=this.memory;return[heap.call.nf_session_advance(
problem.at,fixed,state2,next2,scratch,shapes.at,depth,...numbers.map(BigInt),done),...heap.integers(done,3)].map(
Number)},[fault,stops,points,rays]=advance();if(rays>MAX_RAYS)throw this.inputs=before,new RangeError(`the nee\
dle has changed its direction of cutting ${rays} times`);rays>this.rays&&(this.rays=2*rays,this.memory=layOut(
heap,this.memory.end,this,this.memory),[fault,stops,points,rays]=advance()),check(fault);let shape=stops?readShape(
heap,this.memory.shapes,points):this.shape;if(this.failed=shape.status!==STATUS[0],this.failed)return this.inputs=
before,shape;let{state,next}=this.memory;return Object.assign(this.memory,{state:next,next:state}),Object.assign(
this,{depth,shape}),shape}#count({bevel,...held}){return[bevel,held].map(value=>{let key=JSON.stringify(value,
(name,part2)=>name==="name"?null:part2);return this.numbers.has(key)||this.numbers.set(key,this.known.push(value)),
this.numbers.get(key)})}#recall([bevel,held]){return{bevel:this.known[bevel-1],...this.known[held-1]}}#listRays(){
let{heap,memory:{problem,fixed,state,scratch}}=this;return heap.borrow(()=>{let[cut,position]=[MOVE_BYTES*this.
rays,POSITION_BYTES].map(bytes=>heap.take(bytes)),count2=Number(heap.call.nf_session_rays(problem.at,fixed,state,
scratch,cut,position));return{rays:Array.from({length:count2},(_,n)=>({start:heap.floats(cut+MOVE_BYTES*n,1)[0],
numbers:Array.from(heap.integers(cut+MOVE_BYTES*n+8,2),Number)})),changed:heap.integers(position+POSITION_BYTES-
8,1)[0]!==0n}})}save(){let{model,inputs,planes,depth,shape,rays,heap,memory}=this,state=new Uint8Array(heap.memory.
buffer,memory.state,memory.bytes).slice();return{model,inputs,planes,depth,shape,rays,state}}restore({state,...saved}){
this.#layOut(saved),this.heap.put(state,this.memory.state)}path(){let{firstCell,spacing}=this.model,{rays,changed}=this.#listRays(),
alike=(one,other)=>one.every((number2,i)=>number2===other[i]),flip2=({depth,inputs})=>({depth,inputs:{...inputs,
bevel:{...inputs.bevel,side:-inputs.bevel.side}}}),isPoint=depth=>{let cell=depth<=SAME_DEPTH?0:1+Math.max(0,Math.
ceil((depth-firstCell-SAME_DEPTH)/spacing));return Math.abs((cell&&firstCell+(cell-1)*spacing)-depth)<=SAME_DEPTH},
steps2=[];rays.forEach(({start:start2,numbers},n)=>{let again=n>0&&alike(rays[n-1].numbers,numbers);again&&isPoint(
start2)?steps2.pop():again&&steps2.push(flip2(steps2[steps2.length-1])),steps2.push({depth:rays[n+1]?.start??this.
depth,inputs:this.#recall(numbers)})});let last3={depth:this.depth,inputs:this.inputs};return!rays.length||!alike(
rays[rays.length-1].numbers,this.#count(this.inputs))?steps2.push(last3):changed&&steps2.push(flip2(last3),last3),
steps2}again(model,steps2){return this.#begin(model,steps2[0].inputs),steps2.every(({depth,inputs})=>(this.go(
depth,inputs),!this.failed))}positions(s2){let{heap,shape:{x:x2,u,slope:slope4,planes,depth}}=this,at=Float64Array.
from(s2);if(!at.every(one=>one>=x2[0]&&one<=depth))throw new RangeError("s lies beyond the needle");return heap.
borrow(()=>{let out=heap.take(8*(1+planes)*at.length),memory=heap.take(8*(1+5*planes)*(x2.length+2)*Number(heap.
call.nf_lanes())),counts=[planes,1,x2.length,at.length].map(BigInt);return heap.call.nf_positions(...counts,...[
x2,u,slope4,at].map(array3=>heap.put(array3)),memory,out),heap.floats(out,(1+planes)*at.length).slice()})}load(s2){
let{heap,memory:{problem},shape:{planes,x:x2,u,slope:slope4,constraints}}=this;return heap.borrow(()=>{let cells=constraints.
length/(1+planes)-1,needle=heap.structure([x2.length,cells],[],[x2,u,slope4,constraints].map(array3=>heap.put(
array3))),memory=heap.take(heap.call.nf_memory(problem.at,1n)),out=heap.take(8*planes*s2.length);return heap.call.
nf_load(problem.at,needle,BigInt(s2.length),heap.put(Float64Array.from(s2)),memory,out),heap.floats(out,planes*
s2.length).slice()})}}}});function computeBand(session,draws,steps2){let{depth}=steps2[steps2.length-1];if(!(depth>0))return null;let s2=Array.
from({length:POINTS},(_,k2)=>k2===POINTS-1?depth:depth*k2/(POINTS-1)),needles=[],{y:y2,slope:slope4}=steps2[0].
inputs.base;for(let n=0;n<draws.sets;n+=1){let part2=values=>values.slice(n*values.length/draws.sets,(n+1)*values.
length/draws.sets),gain=draws.gain?.[n]??1,path3=steps2.map(({depth:depth2,inputs:{bevel,base,...held}})=>({depth:depth2,
inputs:{...held,bevel:{...bevel,strength:draws.strength[n]},base:{...base,y:y2+gain*(base.y-y2),slope:slope4+gain*
(base.slope-slope4)}}}));session.again({...session.model,mu:part2(draws.mu),law:part2(draws.law)},path3)&&needles.
push(session.positions(s2))}if(!needles.length)return null;let{planes}=session,along=axis=>Array.from({length:POINTS},
(_,k2)=>Float64Array.from(needles,points=>points[(1+planes)*k2+axis])),[across,z=null]=spanBands(planes>1?[along(
1),along(2)]:[along(1)]);return{x:along(0).map(values=>quantile(values.sort(),MIDDLE)),...across,z,failed:draws.
sets-needles.length}}function spanBands(planes){let sizes=new Float64Array(planes[0][0].length),scaled=planes.
map(heights2=>heights2.map(values=>{let sorted=values.slice().sort(),[low,middle,high]=[LOW,MIDDLE,HIGH].map(share=>quantile(
sorted,share));return values.forEach((value,i)=>{let scale=value<middle?middle-low:high-middle;scale>TINY&&(sizes[i]=
Math.max(sizes[i],Math.abs(value-middle)/scale))}),[middle,middle-low,high-middle]})),size=sizes.sort()[Math.min(
Math.floor(LEVEL*sizes.length),sizes.length-1)];return scaled.map(points=>({low:points.map(([middle,below])=>middle-
size*below),high:points.map(([middle,,above])=>middle+size*above)}))}function quantile(sorted,share){let place=share*
(sorted.length-1),below=Math.floor(place);return sorted[below]+(place-below)*((sorted[below+1]??sorted[below])-
sorted[below])}var POINTS,LOW,MIDDLE,HIGH,LEVEL,TINY,init_band=__esm({"needlefit/viewer/page/model/band.js"(){
"use strict";init_needle();POINTS=51,[LOW,MIDDLE,HIGH]=[.025,.5,.975],LEVEL=.95,TINY=1e-9}});var band_worker_exports={};var newest,busy,init_band_worker=__esm({"needlefit/viewer/page/model/band_worker.js"(){
"use strict";init_needle();init_band();newest={},busy=!1;onmessage=async({data})=>{if(newest={...newest,...data},
!busy){busy=!0;for(let order=null;order!==newest;){order=newest;let{kernel,model,draws,steps:steps2,id}=order;
draws&&steps2&&postMessage({id,band:computeBand(await Session.begin(kernel,model,steps2[0].inputs),draws,steps2)}),
await new Promise(resume=>setTimeout(resume))}busy=!1}}}});function computeErrors(session,measured){let{depth}=session.shape,upto=Math.min(depth,measured.depth_mm);if(upto<
1)return null;let beyond=depth-measured.depth_mm,whole=Math.abs(beyond)<=1e-6,[simulated,other]=[[],[]];if(whole)
[simulated,other]=readTarget(session,measured.target,beyond);else if(measured.target.pose!=="free"&&measured.x.
length>1){let s2=Array.from({length:101},(_,i)=>upto*i/100);other=s2.map(one=>[measured.x,measured.y,measured.
z??[]].map(axis=>interpolate(measured.s,axis,one))),simulated=ALIGN[measured.target.pose](readPoints(session,s2),
other)}else return null;let axes=AXES[measured.compared],apart=(one,from,along=axes)=>Math.hypot(...along.map(
axis=>one[axis]-from[axis])),distances=simulated.map((point2,i)=>apart(point2,other[i])),across=axes.slice(1),
tip=measured.tip&&[...measured.tip.x,...measured.tip.y,...measured.tip.z],[end,deflection]=[distances[distances.
length-1],apart(other[other.length-1],other[0],across)];tip&&([end,deflection]=whole?[apart(readPoints(session,
[depth])[0],tip,across),apart(tip,[0,0,0],across)]:[NaN,NaN]);let finite=Object.entries(METRICS).map(([name,compute])=>[
name,compute(distances,end,deflection)]).map(([name,value])=>[name,Number.isFinite(value)?value:null]);return{
...Object.fromEntries(finite),upto_mm:upto,whole,floor_mm:measured.floor_mm}}function readTarget(session,{s:s2,
x:x2,y:y2,z,pose},beyond=0){let measured=x2.map((one,i)=>[one,y2[i],z[i]]),points=readPoints(session,s2.map(one=>one+
beyond)),compared=s2.length>TIP_POINTS?points:[measured[0],[x2[1],...points[1].slice(1)]];return[ALIGN[pose](compared,
measured),measured]}function readPoints(session,s2){let{x:x2,depth,planes}=session.shape,points=session.positions(
s2.map(one=>Math.min(Math.max(one,x2[0]),depth)));return s2.map((_,i)=>[points[(1+planes)*i],points[(1+planes)*
i+1],planes===1?0:points[3*i+2]])}function interpolate(xs,values,x2){let after=xs.findIndex((one,i)=>i&&(one>=
x2||i===xs.length-1)),share=(x2-xs[after-1])/(xs[after]-xs[after-1]);return values[after-1]+Math.min(Math.max(
share,0),1)*(values[after]-values[after-1])}function shiftAcross(moving,fixed){let[dy,dz]=[1,2].map(axis=>mean(
moving.map((point2,i)=>fixed[i][axis]-point2[axis])));return moving.map(([x2,y2,z])=>[x2,y2+dy,z+dz])}function alignRigid(moving,fixed){
let centre=points=>[0,1].map(axis=>mean(points.map(one=>one[axis]))),[m,f]=[centre(moving),centre(fixed)],[across,
along]=[0,0];moving.forEach(([x2,y2],i)=>{let[a2,b,c2,d]=[x2-m[0],y2-m[1],fixed[i][0]-f[0],fixed[i][1]-f[1]];across+=
a2*d-b*c2,along+=a2*c2+b*d});let angle2=Math.atan2(across,along),[c,s2]=[Math.cos(angle2),Math.sin(angle2)];return moving.
map(([x2,y2,z])=>[c*(x2-m[0])-s2*(y2-m[1])+f[0],s2*(x2-m[0])+c*(y2-m[1])+f[1],z])}var mean,METRICS,AXES,TIP_POINTS,
ALIGN,init_errors=__esm({"needlefit/viewer/page/model/errors.js"(){"use strict";mean=values=>values.reduce((sum,one)=>sum+
one,0)/values.length,METRICS={ipe_mean_mm:mean,te_mm:(_,end)=>end,edp_percent:(_,end,deflection)=>100*end/deflection},
AXES={plane:[0,1],space:[0,1,2]};TIP_POINTS=2;ALIGN={known:simulated=>simulated,direction:shiftAcross,free:alignRigid}}});var rollOf,wrap,turnOver,init_bevel=__esm({"needlefit/viewer/page/model/bevel.js"(){"use strict";rollOf=({side,
roll:roll2})=>roll2+(side>0?0:180),wrap=roll2=>180-((180-roll2)%360+360)%360,turnOver=roll2=>roll2%180?["bevel\
_roll_deg",null,wrap(roll2+180)]:["bevel_side",null,roll2%360?1:-1]}});function signed(value,digits2){let size=Math.abs(value).toFixed(digits2);return Number(size)===0?size:(value<0?
"−":"+")+size}function modulusLike(one){let[unit,pascals]=one<1e6?["kPa",1e3]:["MPa",1e6],write2=(value,digits2=4)=>brief(
value/pascals,digits2),step=10**Math.floor(Math.log10(one/pascals)-1);return{unit,step,write:write2,read:text2=>Number(
text2)*pascals}}function modulus(value){let{unit,write:write2}=modulusLike(value);return`${write2(value,3)} ${unit}`}
function isSteered(state,scene){let{steps:steps2}=scene.simulation,{inputs}=steps2.find(({depth})=>depth>=state.
depth_mm-1e-6)??steps2[steps2.length-1],{base,guides,tip}=state;return isChanged(state,scene)||state.bevel.roll_deg!==
wrap(rollOf(inputs.bevel))||tip.held!==!!inputs.tip||base.input_y!==inputs.base.y||base.input_slope!==inputs.base.
slope||guides.length!==inputs.guides.length||guides.some(({x:x2,y:y2},i)=>x2!==inputs.guides[i].x||y2!==inputs.
guides[i].y)}var writeError,listErrors,brief,counted,toDegrees,degrees,slope,shortName,OFFSET,ANGLE,strengthOf,
describeRoll,near,isChanged,predictionOf,init_quantities=__esm({"needlefit/viewer/page/quantities.js"(){"use s\
trict";init_bevel();writeError=(value,unit)=>value===null?"–":unit==="%"?brief(value,3):value.toFixed(3),listErrors=
(errors,{metrics})=>metrics.map(([name,label,unit])=>`${label} ${writeError(errors[name],unit)} ${unit}`);brief=
(value,digits2=4)=>String(Number(value.toPrecision(digits2))),counted=(count2,one)=>`${count2} ${one}${count2===
1?"":"s"}`;toDegrees=rotation=>rotation*180/Math.PI,degrees=slope4=>Math.atan(slope4)*180/Math.PI,slope=angle2=>Math.
tan(Math.min(Math.max(angle2,-90),90)*Math.PI/180),shortName=({item,name})=>name&&name!==`guide ${item}`?name:
String(item),OFFSET={symbol:"b",unit:"mm",digits:3,step:.005,here:"bevel_offset_mm",throughout:"offset_through\
out_mm"},ANGLE={symbol:"θ",unit:"°",digits:2,step:.1,here:"cut_angle_deg",throughout:"cut_angle_throughout_d\
eg"},strengthOf=({offset_mm:offset,cut_angle_deg:angle2})=>angle2===void 0?{...OFFSET,value:offset??0}:{...ANGLE,
value:angle2},describeRoll=({roll_deg:roll2})=>roll2%180?`roll ${brief(roll2).replace("-","−")}°`:roll2?"−y":
"+y",near=(one,other)=>Math.abs(one-other)<=1e-9*Math.abs(other),isChanged=({bevel,layers},{fitted})=>!near(strengthOf(
bevel).value,strengthOf(fitted).value)||layers.some((layer,i)=>Object.entries(fitted.layers[i]).some(([name,one])=>!near(
layer[name],one))),predictionOf=(state,scene)=>Math.abs(state.depth_mm-scene.depth_mm)<1e-6&&!isSteered(state,
scene)?scene.measured?.prediction??null:null}});function checkChange([name,item,value],rules){let known=rules.inputs[name];if(!known)throw new ModelError(`the\
re is no input ${name}`,`one of ${Object.keys(rules.inputs).join(", ")}`);let counted2=item!==null&&Number.isInteger(
item)&&item>=1&&item<=(known.item==="guide"?rules.max_guide:1/0);if(known.item?!counted2:item!==null)throw new ModelError(
`${name} has item ${item}`,`the number of a ${known.item}`);let most=name.endsWith("_mm")?rules.max_mm:rules.max,
{least:least2=-1/0,above=-1/0,upto=1/0,below=1/0,values}=known;if(!(Math.abs(value)<=most&&value>=least2&&value>
above&&value<=upto&&value<below&&(!values||values.includes(value)))){let which=item===null?"":` of ${known.item}\
 ${item}`;throw new ModelError(`${nameOf(name)}${which} is ${written(name,value)}`,Math.abs(value)<=most&&known.
expected||`a number, at most ${written(name,most)}`)}}function written(name,value){if(name==="mu_pa")return modulus(
value);if(name.endsWith("slope"))return`${degrees(value).toFixed(1)}°`;let[,unit]=UNITS.find(([end])=>name.endsWith(
end))??["",""];return brief(value,6)+unit}function guideNumber(name,names){let at=names.indexOf(name);return at<
0?Number(name.replace("guide ","")):at+1}function applyChanges({depth,inputs:{bevel,base,guides,tip}},changes,names,stands,{
pathAngle}){let values=new Map(changes.filter(([,item])=>item===null).map(([name,,value])=>[name,value])),of=(name,now2)=>values.
get(name)??now2,[angle2,offset,side]=[of("cut_angle_deg",null),of("bevel_offset_mm",null),of("bevel_side",null)];
if(pathAngle?offset:angle2)throw new ModelError("the strength of the bevel is that of the other rule of advanc\
e",pathAngle?"a cut angle alone":"an offset alone");let roll2=of("bevel_roll_deg",side===null?rollOf(bevel):rollOf(
{side,roll:0})),held=tip;if(of("tip_held",1)===0)held=null;else if(tip||values.has("tip_held")||values.has("ti\
p_y_mm")){let[y2,z]=tip?[tip.y,tip.z??0]:stands;held={y:of("tip_y_mm",y2),slope:of("tip_slope",tip&&tip.slope),
z}}return{depth:of("depth_mm",depth),inputs:{bevel:{...toSide(roll2),strength:(pathAngle?angle2&&angle2*RADIANS:
offset)??bevel.strength},base:{...base,y:of("base_y_mm",base.y),slope:of("base_slope",base.slope)},guides:applyToGuides(
guides,changes,names),tip:held}}}function applyToGuides(guides,changes,names){let moves=new Map;for(let[name,item,
value]of changes)item===null||!name.startsWith("guide_")||moves.set(item,{...moves.get(item),[name.slice(6)]:value});
if(!moves.size)return guides;let now2=new Map(guides.map(guide=>[guide.name,guide]));for(let[item,moved]of[...moves].
sort(([one],[other])=>one-other)){let name=names[item-1]??`guide ${item}`;if(moved.engaged===0){now2.delete(name);
continue}let guide={slope:0,x:moved.x_mm,y:moved.y_mm,...now2.get(name)};if(guide.x===void 0||guide.y===void 0)
throw new ModelError(`there is no ${name}`,"guide_x_mm and guide_y_mm together, which make a guide");let slope4=moved.
slope??guide.slope;moved.turns_freely!==void 0&&(slope4=moved.turns_freely?null:moved.slope??guide.slope??0),now2.
set(name,{name,x:moved.x_mm??guide.x,y:moved.y_mm??guide.y,slope:slope4})}let ordered=[...now2.values()].sort(
(one,other)=>one.x-other.x),twice=ordered.find((guide,i)=>guide.x===ordered[i+1]?.x);if(twice)throw new ModelError(
`two guides stand at the same x = ${twice.x} mm`,"guides at different x");return ordered}var ModelError,RADIANS,
UNITS,nameOf,toSide,init_inputs=__esm({"needlefit/viewer/page/model/inputs.js"(){"use strict";init_quantities();
init_bevel();ModelError=class extends Error{constructor(what,expected){super(what),this.what=what,this.expected=
expected}},RADIANS=Math.PI/180,UNITS=[["_mm"," mm"],["_deg","°"],["_pa"," Pa"]];nameOf=name=>name.replace(/_(mm|deg|pa)$/,
"").replaceAll("_"," ");toSide=roll2=>Math.abs(roll2%360)===180?{side:-1,roll:roll2-180}:{side:1,roll:roll2}}});function makeLaw({terms,tables},shape){if(!terms)return tables.find(([known])=>JSON.stringify(known)===JSON.stringify(
shape))?.[1]??null;let layers=shape[0]?.length??terms.layers;return Array.from({length:layers},(_,layer)=>terms.
at_zero.map((value,j)=>{let by=terms.slopes.findIndex(row=>row[j]);return by<0?value:value+shape[by][layer]*terms.
slopes[by][j]})).flat()}var BEARABLE,SteeredNeedle,init_steered=__esm({"needlefit/viewer/page/model/steered.js"(){
"use strict";init_needle();init_inputs();BEARABLE="a load that tissue and needle can bear";SteeredNeedle=class _SteeredNeedle{static async begin(kernel,scene){
let{model,steps:steps2}=scene.simulation;return new _SteeredNeedle(scene,await Session.begin(kernel,model,steps2[0].
inputs))}way=null;number=0;saved=new Map;constructor(scene,session){this.scene=scene,this.session=session,this.
rules=scene.simulation.rules,this.names=scene.guide_names,this.keep()}get model(){return this.session.model}reach(){
let[first]=this.session.inputs.guides;return this.model.length+(first&&first.x<0?first.x-this.rules.clearance_mm:
0)-1e-6}get tipLateral(){return this.session.positions([this.session.shape.depth])[1]}listWay(){let ways=[];for(let way=this.
way;way;way=way.before)ways.push(way);return ways.reverse()}keep(){this.saved.has(this.number)||this.saved.set(
this.number,{way:this.way,session:this.session.save()})}rewind(){let first=this.saved.get(0);this.#return(first),
Object.assign(this,{number:0,saved:new Map([[0,first]])})}#return({session,way}){this.session.restore(session),
this.way=way}shapeAfter(changes){let shape=this.model.shape.map(row=>[...row]);for(let[name,item,value]of changes){
let row=this.scene.shape_parameters.findIndex(one=>one.name===name);row>=0&&item&&(shape[row][item-1]=value)}return shape}apply(changes){
for(let[i,change2]of changes.entries()){checkChange(change2,this.rules);let[name,item]=change2;if(changes.slice(
0,i).some(([one,other])=>one===name&&other===item))throw new ModelError(`${name} has two values in one step`,"\
one value for each input");if(name==="return_to"&&changes.length>1)throw new ModelError("return_to stands besi\
de other inputs","a step of its own")}if(changes[0]?.[0]==="return_to"){let saved=this.saved.get(changes[0][2]);
if(!saved)throw new ModelError(`nothing was kept of step ${changes[0][2]}`,"a step to return to");this.#return(
saved)}else this.#advance(changes),this.way={changes,tip:this.tipLateral,before:this.way};this.number+=1}#advance(changes){
let parameters=changes.filter(([name])=>this.rules.inputs[name].parameter),others=changes.filter(([name])=>!this.
rules.inputs[name].parameter);if(!parameters.length)return this.#move(others);let before=this.session.save();try{
this.#simulateAgain(parameters),this.#move(others)}catch(error){throw this.session.restore(before),error}}#simulateAgain(parameters){
let{model,session,scene}=this,mu=[...model.mu],strength=null;for(let[name,item,value]of parameters){if(item&&item>
mu.length)throw new ModelError(`there is no layer ${item}`,`one of ${mu.length} layers`);if(name==="mu_pa")mu[Number(
item)-1]=value*1e-6;else if(name==="offset_throughout_mm"&&!model.pathAngle)strength=value;else if(name==="cut\
_angle_throughout_deg"&&model.pathAngle)strength=value*(Math.PI/180);else if(!scene.shape_parameters.some(one=>one.
name===name))throw new ModelError(`the tissue law has no ${name}`,"a parameter of the law")}let shape=this.shapeAfter(
parameters),law=JSON.stringify(shape)===JSON.stringify(model.shape)?model.law:makeLaw(scene.simulation.law,shape);
if(!law)throw new ModelError("the law has not been computed with these parameters","the program");let steps2=session.
path().map(({depth,inputs:{bevel,...held}})=>({depth,inputs:{...held,bevel:{...bevel,strength:strength??bevel.
strength}}}));if(!this.#guard(()=>session.again({...model,mu,law,shape},steps2)))throw new ModelError(`with th\
ese parameters the insertion so far fails ${session.depth.toFixed(1)} mm deep`,BEARABLE)}#move(changes){let{session}=this,
{x:x2,u,planes}=session.shape,{depth,inputs}=applyChanges(session,changes,this.names,[u[x2.length-1],planes>1?
u[u.length-1]:0],this.model);if(!changes.length)return;let shape=this.#guard(()=>session.go(depth,inputs));if(session.
failed)throw new ModelError(`the model finds no needle there (${shape.status})`,BEARABLE)}#guard(work){try{return work()}catch(error){
throw error instanceof RangeError?new ModelError(error.message,`a needle of ${this.model.length} mm, its base \
before guides and tissue`):error}}}}});function listKeys({fitted,shape_parameters:shapes}){let{throughout,symbol}=strengthOf(fitted),[name,toModel]=symbol===
"b"?["b",1]:["theta",Math.PI/180];return[[name,throughout,null,1,toModel,({inputs})=>inputs.bevel.strength],...fitted.
layers.flatMap((_,i)=>[[`mu${i+1}`,"mu_pa",i+1,1e3,.001,({model})=>model.mu[i]],...shapes.map(({name:name2},row)=>[
name2+(i+1),name2,i+1,1,1,({model})=>model.shape[row][i]])])]}async function writeAddress(kernel,steered,name=null){
let{scene,session}=steered,path3=session.path(),rolls=path3.map(({inputs:inputs2})=>wrap(rollOf(inputs2.bevel))),
values=new URLSearchParams(name===null?{}:{needle:name});values.set("depth",String(session.depth)),values.set(
"roll",String(rolls.at(-1)));let turns=path3.slice(0,-1).map(({depth},i)=>{let by=shorten(wrap(rolls[i+1]-rolls[i]));
return by===180?depth:`${depth}:${by}`});turns.length&&values.set("turn",turns.join(","));let{model,steps:[{inputs}]}=scene.
simulation;for(let[key,,item,,toModel,read]of listKeys(scene)){let value=read(session);(!item||value!==read({model,
inputs}))&&values.set(key,String(shorten(value/toModel)))}let address=values.toString().replaceAll("%2C",",").
replaceAll("%3A",":");return await leadsTo(kernel,address,steered)?address:null}async function leadsTo(kernel,address,steered){
let other=await SteeredNeedle.begin(kernel,steered.scene);try{for(let changes of readAddress(address,steered.scene))
other.apply(changes)}catch(error){if(!(error instanceof ModelError))throw error;return!1}let s2=Array.from({length:POINTS2},
(_,i)=>steered.session.depth*i/(POINTS2-1)),[reached,wanted]=[other,steered].map(({session})=>readPoints(session,
s2));return reached.every((point2,i)=>Math.hypot(...point2.map((value,axis)=>value-wanted[i][axis]))<SAME)}function readAddress(address,scene){
let values=new URLSearchParams(address),keys=listKeys(scene),known=["needle","depth","roll","turn",...keys.map(
([key])=>key)],number2=(key,text2,low=-1/0)=>{let value=Number(text2);if(text2?.trim()&&Number.isFinite(value)&&
value>=low)return value;throw new ModelError(`the address has ${key}=${text2}`,low<0?"a number":`a number, ${low}\
 or above`)};for(let key of values.keys())if(!known.includes(key))throw new ModelError(`the address has ${key}`,
known.join(", "));let doubled=[...values.keys()].find(key=>values.getAll(key).length>1);if(doubled)throw new ModelError(
`the address has ${doubled} more than once`,"each key once");if(!values.has("depth")){if([...values.keys()].some(
key=>key!=="needle"))throw new ModelError("the address has no depth","depth=, in mm");return[]}let[first]=scene.
simulation.steps,depth=number2("depth",values.get("depth"),0),turns=(values.get("turn")??"").split(",").filter(
Boolean).map(text2=>{let[at,by="180"]=text2.split(":");return{at:number2("turn",at,0),by:number2("turn",by)}});
if(!turns.every(({at},i)=>at>0&&at>=(turns[i-1]?.at??0)&&at<=depth))throw new ModelError(`the address has turn\
=${values.get("turn")}`,`increasing depths, up to ${depth} mm`);let roll2=values.has("roll")?number2("roll",values.
get("roll")):rollOf(first.inputs.bevel),after=turns.toReversed().map(({by})=>{let end=roll2;return roll2=wrap(
roll2-by),end}).reverse(),inputs=keys.filter(([key])=>values.has(key)).map(([key,input,item,toInput])=>[input,
item,toInput*number2(key,values.get(key))]),lists=[[["return_to",null,0]],[["bevel_roll_deg",null,roll2],...inputs]];
return turns.forEach(({at},i)=>lists.push([["depth_mm",null,at]],[["bevel_roll_deg",null,after[i]]])),[...lists,
[["depth_mm",null,depth]]]}function writeRecording(head,steered){let rows=steered.listWay().flatMap(({changes,
tip},i)=>changes.map(([name,item,value],n)=>`${i+1},${(i/10).toFixed(4)},${name},${item??""},${value},${n===changes.
length-1?tip:""}`));return`${head}${rows.join(`
`)}
`}var POINTS2,SAME,DIGITS,shorten,nameIn,init_address=__esm({"needlefit/viewer/page/address.js"(){"use strict";
init_errors();init_bevel();init_inputs();init_steered();init_quantities();POINTS2=21,SAME=1e-6,DIGITS=12;shorten=
value=>Number(value.toPrecision(DIGITS));nameIn=address=>new URLSearchParams(address).get("needle")}});function publish(kind,message){for(let hear2 of listeners[kind]??[])hear2(message)}function take(kind,message){
Object.assign(now,{[kind]:message}),publish(kind,message)}var now,listeners,listen,redraw,init_store=__esm({"n\
eedlefit/viewer/page/store.js"(){"use strict";now={replay:null,band:null,pinned:null,labels:[],avoided:[],shown:{
measured:!0,band:!0,plan:!0,pinned:!0,errors:!1,points:!1,path:!1,load:!1,inset:!1}};Object.assign(window,{needlefit:now});
listeners={},listen=(kind,hear2)=>(listeners[kind]??=[]).push(hear2);redraw=()=>publish("redraw")}});function computeBands(worker){let ordered="";worker.postMessage({kernel:now.data.kernel});let about=()=>({needle:now.
data.needles.indexOf(now.needle),step:now.state.step});function order(){if(!now.state||ordered===JSON.stringify(
about()))return;ordered=JSON.stringify(about());let{session}=now.steered;worker.postMessage({id:about(),model:session.
model,steps:session.path()})}worker.onmessage=({data:{id,band}})=>{id.needle===about().needle&&take("band",band&&
{step:id.step,...band})},listen("scene",({draws})=>{ordered="",worker.postMessage({draws,steps:null})}),listen(
"drawn",order)}var init_bands=__esm({"needlefit/viewer/page/bands.js"(){"use strict";init_store()}});function write(id,text2){let place=part(id);place.textContent!==text2&&(place.textContent=text2)}function element(tag,properties={},...contents){
let made=Object.assign(document.createElement(tag),properties);return made.append(...contents.flat()),made}var part,
press,entry,init_dom=__esm({"needlefit/viewer/page/dom.js"(){"use strict";part=id=>typeof id=="string"?document.
getElementById(id):id;press=(id,act)=>part(id).addEventListener("click",act),entry=(term,value)=>element("div",
{},element("dt",{},term),element("dd",{},value))}});function ascending(a2,b){return a2==null||b==null?NaN:a2<b?-1:a2>b?1:a2>=b?0:NaN}function descending(a2,b){return a2==
null||b==null?NaN:b<a2?-1:b>a2?1:b>=a2?0:NaN}function bisector(f){let compare1,compare2,delta;f.length!==2?(compare1=
ascending,compare2=(d,x2)=>ascending(f(d),x2),delta=(d,x2)=>f(d)-x2):(compare1=f===ascending||f===descending?f:
zero,compare2=f,delta=f);function left(a2,x2,lo=0,hi=a2.length){if(lo<hi){if(compare1(x2,x2)!==0)return hi;do{
let mid=lo+hi>>>1;compare2(a2[mid],x2)<0?lo=mid+1:hi=mid}while(lo<hi)}return lo}function right(a2,x2,lo=0,hi=a2.
length){if(lo<hi){if(compare1(x2,x2)!==0)return hi;do{let mid=lo+hi>>>1;compare2(a2[mid],x2)<=0?lo=mid+1:hi=mid}while(lo<
hi)}return lo}function center(a2,x2,lo=0,hi=a2.length){let i=left(a2,x2,lo,hi-1);return i>lo&&delta(a2[i-1],x2)>
-delta(a2[i],x2)?i-1:i}return{left,center,right}}function zero(){return 0}function number(x2){return x2===null?
NaN:+x2}function Blur2(blur){return function(data,rx,ry=rx){if(!((rx=+rx)>=0))throw new RangeError("invalid rx");
if(!((ry=+ry)>=0))throw new RangeError("invalid ry");let{data:values,width,height}=data;if(!((width=Math.floor(
width))>=0))throw new RangeError("invalid width");if(!((height=Math.floor(height!==void 0?height:values.length/
width))>=0))throw new RangeError("invalid height");if(!width||!height||!rx&&!ry)return data;let blurx=rx&&blur(
rx),blury=ry&&blur(ry),temp=values.slice();return blurx&&blury?(blurh(blurx,temp,values,width,height),blurh(blurx,
values,temp,width,height),blurh(blurx,temp,values,width,height),blurv(blury,values,temp,width,height),blurv(blury,
temp,values,width,height),blurv(blury,values,temp,width,height)):blurx?(blurh(blurx,values,temp,width,height),
blurh(blurx,temp,values,width,height),blurh(blurx,values,temp,width,height)):blury&&(blurv(blury,values,temp,width,
height),blurv(blury,temp,values,width,height),blurv(blury,values,temp,width,height)),data}}function blurh(blur,T,S,w,h){
for(let y2=0,n=w*h;y2<n;)blur(T,S,y2,y2+=w,1)}function blurv(blur,T,S,w,h){for(let x2=0,n=w*h;x2<w;++x2)blur(T,
S,x2,x2+n,w)}function blurfImage(radius){let blur=blurf(radius);return(T,S,start2,stop,step)=>{start2<<=2,stop<<=
2,step<<=2,blur(T,S,start2+0,stop+0,step),blur(T,S,start2+1,stop+1,step),blur(T,S,start2+2,stop+2,step),blur(T,
S,start2+3,stop+3,step)}}function blurf(radius){let radius0=Math.floor(radius);if(radius0===radius)return bluri(
radius);let t=radius-radius0,w=2*radius+1;return(T,S,start2,stop,step)=>{if(!((stop-=step)>=start2))return;let sum=radius0*
S[start2],s0=step*radius0,s1=s0+step;for(let i=start2,j=start2+s0;i<j;i+=step)sum+=S[Math.min(stop,i)];for(let i=start2,
j=stop;i<=j;i+=step)sum+=S[Math.min(stop,i+s0)],T[i]=(sum+t*(S[Math.max(start2,i-s1)]+S[Math.min(stop,i+s1)]))/
w,sum-=S[Math.max(start2,i-s0)]}}function bluri(radius){let w=2*radius+1;return(T,S,start2,stop,step)=>{if(!((stop-=
step)>=start2))return;let sum=radius*S[start2],s2=step*radius;for(let i=start2,j=start2+s2;i<j;i+=step)sum+=S[Math.
min(stop,i)];for(let i=start2,j=stop;i<=j;i+=step)sum+=S[Math.min(stop,i+s2)],T[i]=sum/w,sum-=S[Math.max(start2,
i-s2)]}}function extent(values,valueof){let min,max2;if(valueof===void 0)for(let value of values)value!=null&&
(min===void 0?value>=value&&(min=max2=value):(min>value&&(min=value),max2<value&&(max2=value)));else{let index=-1;
for(let value of values)(value=valueof(value,++index,values))!=null&&(min===void 0?value>=value&&(min=max2=value):
(min>value&&(min=value),max2<value&&(max2=value)))}return[min,max2]}function tickSpec(start2,stop,count2){let step=(stop-
start2)/Math.max(0,count2),power=Math.floor(Math.log10(step)),error=step/Math.pow(10,power),factor=error>=e10?
10:error>=e5?5:error>=e2?2:1,i1,i2,inc;return power<0?(inc=Math.pow(10,-power)/factor,i1=Math.round(start2*inc),
i2=Math.round(stop*inc),i1/inc<start2&&++i1,i2/inc>stop&&--i2,inc=-inc):(inc=Math.pow(10,power)*factor,i1=Math.
round(start2/inc),i2=Math.round(stop/inc),i1*inc<start2&&++i1,i2*inc>stop&&--i2),i2<i1&&.5<=count2&&count2<2?tickSpec(
start2,stop,count2*2):[i1,i2,inc]}function ticks(start2,stop,count2){if(stop=+stop,start2=+start2,count2=+count2,
!(count2>0))return[];if(start2===stop)return[start2];let reverse=stop<start2,[i1,i2,inc]=reverse?tickSpec(stop,
start2,count2):tickSpec(start2,stop,count2);if(!(i2>=i1))return[];let n=i2-i1+1,ticks2=new Array(n);if(reverse)
if(inc<0)for(let i=0;i<n;++i)ticks2[i]=(i2-i)/-inc;else for(let i=0;i<n;++i)ticks2[i]=(i2-i)*inc;else if(inc<0)
for(let i=0;i<n;++i)ticks2[i]=(i1+i)/-inc;else for(let i=0;i<n;++i)ticks2[i]=(i1+i)*inc;return ticks2}function tickIncrement(start2,stop,count2){
return stop=+stop,start2=+start2,count2=+count2,tickSpec(start2,stop,count2)[2]}function nice(start2,stop,count2){
let prestep;for(;;){let step=tickIncrement(start2,stop,count2);if(step===prestep||step===0||!isFinite(step))return[
start2,stop];if(step>0){let i=Math.ceil(start2/step),j=Math.floor(stop/step);start2=(i-(i*step>start2))*step,stop=
(j+(j*step<stop))*step}else if(step<0){let s2=-step,i=Math.ceil(start2*s2),j=Math.floor(stop*s2);start2=(i-(i/
s2>start2))/s2,stop=(j+(j/s2<stop))/s2}prestep=step}}function max(values,valueof){let max2;if(valueof===void 0)
for(let value of values)value!=null&&(max2<value||max2===void 0&&value>=value)&&(max2=value);else{let index=-1;
for(let value of values)(value=valueof(value,++index,values))!=null&&(max2<value||max2===void 0&&value>=value)&&
(max2=value)}return max2}function range(start2,stop,step){start2=+start2,stop=+stop,step=(n=arguments.length)<
2?(stop=start2,start2=0,1):n<3?1:+step;for(var i=-1,n=Math.max(0,Math.ceil((stop-start2)/step))|0,range2=new Array(
n);++i<n;)range2[i]=start2+i*step;return range2}function least(values,compare=ascending){let min,defined=!1;if(compare.
length===1){let minValue;for(let element2 of values){let value=compare(element2);(defined?ascending(value,minValue)<
0:ascending(value,value)===0)&&(min=element2,minValue=value,defined=!0)}}else for(let value of values)(defined?
compare(value,min)<0:compare(value,value)===0)&&(min=value,defined=!0);return min}function shuffler(random){return function(array3,i0=0,i1=array3.
length){let m=i1-(i0=+i0);for(;m;){let i=random()*m--|0,t=array3[m+i0];array3[m+i0]=array3[i+i0],array3[i+i0]=
t}return array3}}var ascendingBisect,bisectRight,bisectLeft,bisectCenter,blur2,blurImage,array,slice,e10,e5,e2,
shuffle,init_d3_array=__esm({"node_modules/d3-array/dist/d3-array.mjs"(){ascendingBisect=bisector(ascending),bisectRight=
ascendingBisect.right,bisectLeft=ascendingBisect.left,bisectCenter=bisector(number).center,blur2=Blur2(blurf),
blurImage=Blur2(blurfImage);array=Array.prototype,slice=array.slice,e10=Math.sqrt(50),e5=Math.sqrt(10),e2=Math.
sqrt(2);shuffle=shuffler(Math.random)}});function append(strings){this._+=strings[0];for(let i=1,n=strings.length;i<n;++i)this._+=arguments[i]+strings[i]}
function appendRound(digits2){let d=Math.floor(digits2);if(!(d>=0))throw new Error(`invalid digits: ${digits2}`);
if(d>15)return append;let k2=10**d;return function(strings){this._+=strings[0];for(let i=1,n=strings.length;i<
n;++i)this._+=Math.round(arguments[i]*k2)/k2+strings[i]}}function equal(x0,y0,x1,y1){return x0===x1&&y0===y1}function equalRound(digits2){
let d=Math.floor(digits2);if(!(d<=15))return equal;let k2=10**d,r=function(value){return Math.round(value*k2)};
return function(x0,y0,x1,y1){return r(x0)===r(x1)&&r(y0)===r(y1)}}function path(){return new Path}var pi,tau,epsilon,
tauEpsilon,Path,init_d3_path=__esm({"node_modules/d3-path/dist/d3-path.mjs"(){pi=Math.PI,tau=2*pi,epsilon=1e-6,
tauEpsilon=tau-epsilon;Path=class{constructor(digits2){this._x0=this._y0=this._x1=this._y1=null,this._="",this.
_append=digits2==null?append:appendRound(digits2),this._equal=digits2==null?equal:equalRound(digits2)}moveTo(x2,y2){
this._append`M${this._x0=this._x1=+x2},${this._y0=this._y1=+y2}`}closePath(){this._x1!==null&&(this._x1=this._x0,
this._y1=this._y0,this._append`Z`)}lineTo(x2,y2){this._append`L${this._x1=+x2},${this._y1=+y2}`}quadraticCurveTo(x1,y1,x2,y2){
this._append`Q${+x1},${+y1},${this._x1=+x2},${this._y1=+y2}`}bezierCurveTo(x1,y1,x2,y2,x3,y3){this._append`C${+x1},${+y1},${+x2},${+y2},${this.
_x1=+x3},${this._y1=+y3}`}arcTo(x1,y1,x2,y2,r){if(x1=+x1,y1=+y1,x2=+x2,y2=+y2,r=+r,r<0)throw new Error(`negati\
ve radius: ${r}`);let x0=this._x1,y0=this._y1,x21=x2-x1,y21=y2-y1,x01=x0-x1,y01=y0-y1,l01_2=x01*x01+y01*y01;if(this.
_x1===null)this._append`M${this._x1=x1},${this._y1=y1}`;else if(l01_2>epsilon)if(!(Math.abs(y01*x21-y21*x01)>epsilon)||
!r)this._append`L${this._x1=x1},${this._y1=y1}`;else{let x20=x2-x0,y20=y2-y0,l21_2=x21*x21+y21*y21,l20_2=x20*x20+
y20*y20,l21=Math.sqrt(l21_2),l01=Math.sqrt(l01_2),l=r*Math.tan((pi-Math.acos((l21_2+l01_2-l20_2)/(2*l21*l01)))/
2),t01=l/l01,t21=l/l21;Math.abs(t01-1)>epsilon&&this._append`L${x1+t01*x01},${y1+t01*y01}`,this._append`A${r},${r},0,0,${+(y01*
x20>x01*y20)},${this._x1=x1+t21*x21},${this._y1=y1+t21*y21}`}}arc(x2,y2,r,a0,a1,ccw){if(x2=+x2,y2=+y2,r=+r,ccw=
!!ccw,r<0)throw new Error(`negative radius: ${r}`);let dx=r*Math.cos(a0),dy=r*Math.sin(a0),x0=x2+dx,y0=y2+dy,cw=1^
ccw,da=ccw?a0-a1:a1-a0;if(this._x1===null?this._append`M${x0},${y0}`:(Math.abs(this._x1-x0)>epsilon||Math.abs(
this._y1-y0)>epsilon)&&this._append`L${x0},${y0}`,!!r){if(da<0&&(da=da%tau+tau),da>tauEpsilon)this._append`A${r},${r},0,1,${cw},${x2-
dx},${y2-dy}A${r},${r},0,1,${cw},${this._x1=x0},${this._y1=y0}`;else if(da>epsilon){let x1=x2+r*Math.cos(a1),y1=y2+
r*Math.sin(a1);if(da>=pi&&this._equal(x0,y0,x1,y1)){da/=2;let a00=a0+da;this._append`A${r},${r},0,${+(da>=pi)},${cw},${x2+
r*Math.cos(a00)},${y2+r*Math.sin(a00)}`}this._append`A${r},${r},0,${+(da>=pi)},${cw},${this._x1=x1},${this._y1=
y1}`}}}rect(x2,y2,w,h){this._append`M${this._x0=this._x1=+x2},${this._y0=this._y1=+y2}h${w=+w}v${+h}h${-w}Z`}toString(){
return this._}};path.prototype=Path.prototype}});function constant(x2){return function(){return x2}}function withPath(shape){let digits2=3;return shape.digits=
function(_){if(!arguments.length)return digits2;if(_==null)digits2=null;else{let d=Math.floor(_);if(!(d>=0))throw new RangeError(
`invalid digits: ${_}`);digits2=d}return shape},()=>new Path(digits2)}function array2(x2){return typeof x2=="o\
bject"&&"length"in x2?x2:Array.from(x2)}function Linear(context){this._context=context}function curveLinear(context){
return new Linear(context)}function x(p){return p[0]}function y(p){return p[1]}function line(x$1,y$1){var defined=constant(
!0),context=null,curve=curveLinear,output=null,path3=withPath(line2);x$1=typeof x$1=="function"?x$1:x$1===void 0?
x:constant(x$1),y$1=typeof y$1=="function"?y$1:y$1===void 0?y:constant(y$1);function line2(data){var i,n=(data=
array2(data)).length,d,defined0=!1,buffer;for(context==null&&(output=curve(buffer=path3())),i=0;i<=n;++i)!(i<n&&
defined(d=data[i],i,data))===defined0&&((defined0=!defined0)?output.lineStart():output.lineEnd()),defined0&&output.
point(+x$1(d,i,data),+y$1(d,i,data));if(buffer)return output=null,buffer+""||null}return line2.x=function(_){return arguments.
length?(x$1=typeof _=="function"?_:constant(+_),line2):x$1},line2.y=function(_){return arguments.length?(y$1=typeof _==
"function"?_:constant(+_),line2):y$1},line2.defined=function(_){return arguments.length?(defined=typeof _=="fu\
nction"?_:constant(!!_),line2):defined},line2.curve=function(_){return arguments.length?(curve=_,context!=null&&
(output=curve(context)),line2):curve},line2.context=function(_){return arguments.length?(_==null?context=output=
null:output=curve(context=_),line2):context},line2}function area(x0,y0,y1){var x1=null,defined=constant(!0),context=null,
curve=curveLinear,output=null,path3=withPath(area2);x0=typeof x0=="function"?x0:x0===void 0?x:constant(+x0),y0=
typeof y0=="function"?y0:constant(y0===void 0?0:+y0),y1=typeof y1=="function"?y1:y1===void 0?y:constant(+y1);function area2(data){
var i,j,k2,n=(data=array2(data)).length,d,defined0=!1,buffer,x0z=new Array(n),y0z=new Array(n);for(context==null&&
(output=curve(buffer=path3())),i=0;i<=n;++i){if(!(i<n&&defined(d=data[i],i,data))===defined0)if(defined0=!defined0)
j=i,output.areaStart(),output.lineStart();else{for(output.lineEnd(),output.lineStart(),k2=i-1;k2>=j;--k2)output.
point(x0z[k2],y0z[k2]);output.lineEnd(),output.areaEnd()}defined0&&(x0z[i]=+x0(d,i,data),y0z[i]=+y0(d,i,data),
output.point(x1?+x1(d,i,data):x0z[i],y1?+y1(d,i,data):y0z[i]))}if(buffer)return output=null,buffer+""||null}function arealine(){
return line().defined(defined).curve(curve).context(context)}return area2.x=function(_){return arguments.length?
(x0=typeof _=="function"?_:constant(+_),x1=null,area2):x0},area2.x0=function(_){return arguments.length?(x0=typeof _==
"function"?_:constant(+_),area2):x0},area2.x1=function(_){return arguments.length?(x1=_==null?null:typeof _=="\
function"?_:constant(+_),area2):x1},area2.y=function(_){return arguments.length?(y0=typeof _=="function"?_:constant(
+_),y1=null,area2):y0},area2.y0=function(_){return arguments.length?(y0=typeof _=="function"?_:constant(+_),area2):
y0},area2.y1=function(_){return arguments.length?(y1=_==null?null:typeof _=="function"?_:constant(+_),area2):y1},
area2.lineX0=area2.lineY0=function(){return arealine().x(x0).y(y0)},area2.lineY1=function(){return arealine().
x(x0).y(y1)},area2.lineX1=function(){return arealine().x(x1).y(y0)},area2.defined=function(_){return arguments.
length?(defined=typeof _=="function"?_:constant(!!_),area2):defined},area2.curve=function(_){return arguments.
length?(curve=_,context!=null&&(output=curve(context)),area2):curve},area2.context=function(_){return arguments.
length?(_==null?context=output=null:output=curve(context=_),area2):context},area2}function Radial(curve){this.
_curve=curve}function curveRadial(curve){function radial(context){return new Radial(curve(context))}return radial.
_curve=curve,radial}function noop(){}function point$3(that,x2,y2){that._context.bezierCurveTo((2*that._x0+that.
_x1)/3,(2*that._y0+that._y1)/3,(that._x0+2*that._x1)/3,(that._y0+2*that._y1)/3,(that._x0+4*that._x1+x2)/6,(that.
_y0+4*that._y1+y2)/6)}function Basis(context){this._context=context}function BasisClosed(context){this._context=
context}function BasisOpen(context){this._context=context}function Bundle(context,beta){this._basis=new Basis(
context),this._beta=beta}function point$2(that,x2,y2){that._context.bezierCurveTo(that._x1+that._k*(that._x2-that.
_x0),that._y1+that._k*(that._y2-that._y0),that._x2+that._k*(that._x1-x2),that._y2+that._k*(that._y1-y2),that._x2,
that._y2)}function Cardinal(context,tension){this._context=context,this._k=(1-tension)/6}function CardinalClosed(context,tension){
this._context=context,this._k=(1-tension)/6}function CardinalOpen(context,tension){this._context=context,this.
_k=(1-tension)/6}function point$1(that,x2,y2){var x1=that._x1,y1=that._y1,x22=that._x2,y22=that._y2;if(that._l01_a>
epsilon2){var a2=2*that._l01_2a+3*that._l01_a*that._l12_a+that._l12_2a,n=3*that._l01_a*(that._l01_a+that._l12_a);
x1=(x1*a2-that._x0*that._l12_2a+that._x2*that._l01_2a)/n,y1=(y1*a2-that._y0*that._l12_2a+that._y2*that._l01_2a)/
n}if(that._l23_a>epsilon2){var b=2*that._l23_2a+3*that._l23_a*that._l12_a+that._l12_2a,m=3*that._l23_a*(that._l23_a+
that._l12_a);x22=(x22*b+that._x1*that._l23_2a-x2*that._l12_2a)/m,y22=(y22*b+that._y1*that._l23_2a-y2*that._l12_2a)/
m}that._context.bezierCurveTo(x1,y1,x22,y22,that._x2,that._y2)}function CatmullRom(context,alpha){this._context=
context,this._alpha=alpha}function CatmullRomClosed(context,alpha){this._context=context,this._alpha=alpha}function CatmullRomOpen(context,alpha){
this._context=context,this._alpha=alpha}function LinearClosed(context){this._context=context}function sign(x2){
return x2<0?-1:1}function slope3(that,x2,y2){var h0=that._x1-that._x0,h1=x2-that._x1,s0=(that._y1-that._y0)/(h0||
h1<0&&-0),s1=(y2-that._y1)/(h1||h0<0&&-0),p=(s0*h1+s1*h0)/(h0+h1);return(sign(s0)+sign(s1))*Math.min(Math.abs(
s0),Math.abs(s1),.5*Math.abs(p))||0}function slope2(that,t){var h=that._x1-that._x0;return h?(3*(that._y1-that.
_y0)/h-t)/2:t}function point(that,t0,t1){var x0=that._x0,y0=that._y0,x1=that._x1,y1=that._y1,dx=(x1-x0)/3;that.
_context.bezierCurveTo(x0+dx,y0+dx*t0,x1-dx,y1-dx*t1,x1,y1)}function MonotoneX(context){this._context=context}
function MonotoneY(context){this._context=new ReflectContext(context)}function ReflectContext(context){this._context=
context}function Natural(context){this._context=context}function controlPoints(x2){var i,n=x2.length-1,m,a2=new Array(
n),b=new Array(n),r=new Array(n);for(a2[0]=0,b[0]=2,r[0]=x2[0]+2*x2[1],i=1;i<n-1;++i)a2[i]=1,b[i]=4,r[i]=4*x2[i]+
2*x2[i+1];for(a2[n-1]=2,b[n-1]=7,r[n-1]=8*x2[n-1]+x2[n],i=1;i<n;++i)m=a2[i]/b[i-1],b[i]-=m,r[i]-=m*r[i-1];for(a2[n-
1]=r[n-1]/b[n-1],i=n-2;i>=0;--i)a2[i]=(r[i]-a2[i+1])/b[i];for(b[n-1]=(x2[n]+a2[n-1])/2,i=0;i<n-1;++i)b[i]=2*x2[i+
1]-a2[i+1];return[a2,b]}function Step(context,t){this._context=context,this._t=t}var cos,sin,sqrt,epsilon2,pi2,
halfPi,tau2,slice2,curveRadialLinear,sqrt3$2,tan30,tan30_2,kr,kx,ky,sqrt3$1,sqrt3,s,k,a,bundle,cardinal,cardinalClosed,
cardinalOpen,catmullRom,catmullRomClosed,catmullRomOpen,init_d3_shape=__esm({"node_modules/d3-shape/dist/d3-sh\
ape.mjs"(){init_d3_path();cos=Math.cos,sin=Math.sin,sqrt=Math.sqrt,epsilon2=1e-12,pi2=Math.PI,halfPi=pi2/2,tau2=
2*pi2;slice2=Array.prototype.slice;Linear.prototype={areaStart:function(){this._line=0},areaEnd:function(){this.
_line=NaN},lineStart:function(){this._point=0},lineEnd:function(){(this._line||this._line!==0&&this._point===1)&&
this._context.closePath(),this._line=1-this._line},point:function(x2,y2){switch(x2=+x2,y2=+y2,this._point){case 0:
this._point=1,this._line?this._context.lineTo(x2,y2):this._context.moveTo(x2,y2);break;case 1:this._point=2;default:
this._context.lineTo(x2,y2);break}}};curveRadialLinear=curveRadial(curveLinear);Radial.prototype={areaStart:function(){
this._curve.areaStart()},areaEnd:function(){this._curve.areaEnd()},lineStart:function(){this._curve.lineStart()},
lineEnd:function(){this._curve.lineEnd()},point:function(a2,r){this._curve.point(r*Math.sin(a2),r*-Math.cos(a2))}};
sqrt3$2=sqrt(3),tan30=sqrt(1/3),tan30_2=tan30*2,kr=sin(pi2/10)/sin(7*pi2/10),kx=sin(tau2/10)*kr,ky=-cos(tau2/10)*
kr,sqrt3$1=sqrt(3),sqrt3=sqrt(3),s=sqrt(3)/2,k=1/sqrt(12),a=(k/2+1)*3;Basis.prototype={areaStart:function(){this.
_line=0},areaEnd:function(){this._line=NaN},lineStart:function(){this._x0=this._x1=this._y0=this._y1=NaN,this.
_point=0},lineEnd:function(){switch(this._point){case 3:point$3(this,this._x1,this._y1);case 2:this._context.lineTo(
this._x1,this._y1);break}(this._line||this._line!==0&&this._point===1)&&this._context.closePath(),this._line=1-
this._line},point:function(x2,y2){switch(x2=+x2,y2=+y2,this._point){case 0:this._point=1,this._line?this._context.
lineTo(x2,y2):this._context.moveTo(x2,y2);break;case 1:this._point=2;break;case 2:this._point=3,this._context.
lineTo((5*this._x0+this._x1)/6,(5*this._y0+this._y1)/6);default:point$3(this,x2,y2);break}this._x0=this._x1,this.
_x1=x2,this._y0=this._y1,this._y1=y2}};BasisClosed.prototype={areaStart:noop,areaEnd:noop,lineStart:function(){
this._x0=this._x1=this._x2=this._x3=this._x4=this._y0=this._y1=this._y2=this._y3=this._y4=NaN,this._point=0},lineEnd:function(){
switch(this._point){case 1:{this._context.moveTo(this._x2,this._y2),this._context.closePath();break}case 2:{this.
_context.moveTo((this._x2+2*this._x3)/3,(this._y2+2*this._y3)/3),this._context.lineTo((this._x3+2*this._x2)/3,
(this._y3+2*this._y2)/3),this._context.closePath();break}case 3:{this.point(this._x2,this._y2),this.point(this.
_x3,this._y3),this.point(this._x4,this._y4);break}}},point:function(x2,y2){switch(x2=+x2,y2=+y2,this._point){case 0:
this._point=1,this._x2=x2,this._y2=y2;break;case 1:this._point=2,this._x3=x2,this._y3=y2;break;case 2:this._point=
3,this._x4=x2,this._y4=y2,this._context.moveTo((this._x0+4*this._x1+x2)/6,(this._y0+4*this._y1+y2)/6);break;default:
point$3(this,x2,y2);break}this._x0=this._x1,this._x1=x2,this._y0=this._y1,this._y1=y2}};BasisOpen.prototype={areaStart:function(){
this._line=0},areaEnd:function(){this._line=NaN},lineStart:function(){this._x0=this._x1=this._y0=this._y1=NaN,
this._point=0},lineEnd:function(){(this._line||this._line!==0&&this._point===3)&&this._context.closePath(),this.
_line=1-this._line},point:function(x2,y2){switch(x2=+x2,y2=+y2,this._point){case 0:this._point=1;break;case 1:
this._point=2;break;case 2:this._point=3;var x0=(this._x0+4*this._x1+x2)/6,y0=(this._y0+4*this._y1+y2)/6;this.
_line?this._context.lineTo(x0,y0):this._context.moveTo(x0,y0);break;case 3:this._point=4;default:point$3(this,
x2,y2);break}this._x0=this._x1,this._x1=x2,this._y0=this._y1,this._y1=y2}};Bundle.prototype={lineStart:function(){
this._x=[],this._y=[],this._basis.lineStart()},lineEnd:function(){var x2=this._x,y2=this._y,j=x2.length-1;if(j>
0)for(var x0=x2[0],y0=y2[0],dx=x2[j]-x0,dy=y2[j]-y0,i=-1,t;++i<=j;)t=i/j,this._basis.point(this._beta*x2[i]+(1-
this._beta)*(x0+t*dx),this._beta*y2[i]+(1-this._beta)*(y0+t*dy));this._x=this._y=null,this._basis.lineEnd()},point:function(x2,y2){
this._x.push(+x2),this._y.push(+y2)}};bundle=(function custom(beta){function bundle2(context){return beta===1?
new Basis(context):new Bundle(context,beta)}return bundle2.beta=function(beta2){return custom(+beta2)},bundle2})(
.85);Cardinal.prototype={areaStart:function(){this._line=0},areaEnd:function(){this._line=NaN},lineStart:function(){
this._x0=this._x1=this._x2=this._y0=this._y1=this._y2=NaN,this._point=0},lineEnd:function(){switch(this._point){case 2:
this._context.lineTo(this._x2,this._y2);break;case 3:point$2(this,this._x1,this._y1);break}(this._line||this._line!==
0&&this._point===1)&&this._context.closePath(),this._line=1-this._line},point:function(x2,y2){switch(x2=+x2,y2=
+y2,this._point){case 0:this._point=1,this._line?this._context.lineTo(x2,y2):this._context.moveTo(x2,y2);break;case 1:
this._point=2,this._x1=x2,this._y1=y2;break;case 2:this._point=3;default:point$2(this,x2,y2);break}this._x0=this.
_x1,this._x1=this._x2,this._x2=x2,this._y0=this._y1,this._y1=this._y2,this._y2=y2}};cardinal=(function custom2(tension){
function cardinal2(context){return new Cardinal(context,tension)}return cardinal2.tension=function(tension2){return custom2(
+tension2)},cardinal2})(0);CardinalClosed.prototype={areaStart:noop,areaEnd:noop,lineStart:function(){this._x0=
this._x1=this._x2=this._x3=this._x4=this._x5=this._y0=this._y1=this._y2=this._y3=this._y4=this._y5=NaN,this._point=
0},lineEnd:function(){switch(this._point){case 1:{this._context.moveTo(this._x3,this._y3),this._context.closePath();
break}case 2:{this._context.lineTo(this._x3,this._y3),this._context.closePath();break}case 3:{this.point(this.
_x3,this._y3),this.point(this._x4,this._y4),this.point(this._x5,this._y5);break}}},point:function(x2,y2){switch(x2=
+x2,y2=+y2,this._point){case 0:this._point=1,this._x3=x2,this._y3=y2;break;case 1:this._point=2,this._context.
moveTo(this._x4=x2,this._y4=y2);break;case 2:this._point=3,this._x5=x2,this._y5=y2;break;default:point$2(this,
x2,y2);break}this._x0=this._x1,this._x1=this._x2,this._x2=x2,this._y0=this._y1,this._y1=this._y2,this._y2=y2}};
cardinalClosed=(function custom3(tension){function cardinal2(context){return new CardinalClosed(context,tension)}
return cardinal2.tension=function(tension2){return custom3(+tension2)},cardinal2})(0);CardinalOpen.prototype={
areaStart:function(){this._line=0},areaEnd:function(){this._line=NaN},lineStart:function(){this._x0=this._x1=this.
_x2=this._y0=this._y1=this._y2=NaN,this._point=0},lineEnd:function(){(this._line||this._line!==0&&this._point===
3)&&this._context.closePath(),this._line=1-this._line},point:function(x2,y2){switch(x2=+x2,y2=+y2,this._point){case 0:
this._point=1;break;case 1:this._point=2;break;case 2:this._point=3,this._line?this._context.lineTo(this._x2,this.
_y2):this._context.moveTo(this._x2,this._y2);break;case 3:this._point=4;default:point$2(this,x2,y2);break}this.
_x0=this._x1,this._x1=this._x2,this._x2=x2,this._y0=this._y1,this._y1=this._y2,this._y2=y2}};cardinalOpen=(function custom4(tension){
function cardinal2(context){return new CardinalOpen(context,tension)}return cardinal2.tension=function(tension2){
return custom4(+tension2)},cardinal2})(0);CatmullRom.prototype={areaStart:function(){this._line=0},areaEnd:function(){
this._line=NaN},lineStart:function(){this._x0=this._x1=this._x2=this._y0=this._y1=this._y2=NaN,this._l01_a=this.
_l12_a=this._l23_a=this._l01_2a=this._l12_2a=this._l23_2a=this._point=0},lineEnd:function(){switch(this._point){case 2:
this._context.lineTo(this._x2,this._y2);break;case 3:this.point(this._x2,this._y2);break}(this._line||this._line!==
0&&this._point===1)&&this._context.closePath(),this._line=1-this._line},point:function(x2,y2){if(x2=+x2,y2=+y2,
this._point){var x23=this._x2-x2,y23=this._y2-y2;this._l23_a=Math.sqrt(this._l23_2a=Math.pow(x23*x23+y23*y23,this.
_alpha))}switch(this._point){case 0:this._point=1,this._line?this._context.lineTo(x2,y2):this._context.moveTo(
x2,y2);break;case 1:this._point=2;break;case 2:this._point=3;default:point$1(this,x2,y2);break}this._l01_a=this.
_l12_a,this._l12_a=this._l23_a,this._l01_2a=this._l12_2a,this._l12_2a=this._l23_2a,this._x0=this._x1,this._x1=
this._x2,this._x2=x2,this._y0=this._y1,this._y1=this._y2,this._y2=y2}};catmullRom=(function custom5(alpha){function catmullRom2(context){
return alpha?new CatmullRom(context,alpha):new Cardinal(context,0)}return catmullRom2.alpha=function(alpha2){return custom5(
+alpha2)},catmullRom2})(.5);CatmullRomClosed.prototype={areaStart:noop,areaEnd:noop,lineStart:function(){this.
_x0=this._x1=this._x2=this._x3=this._x4=this._x5=this._y0=this._y1=this._y2=this._y3=this._y4=this._y5=NaN,this.
_l01_a=this._l12_a=this._l23_a=this._l01_2a=this._l12_2a=this._l23_2a=this._point=0},lineEnd:function(){switch(this.
_point){case 1:{this._context.moveTo(this._x3,this._y3),this._context.closePath();break}case 2:{this._context.
lineTo(this._x3,this._y3),this._context.closePath();break}case 3:{this.point(this._x3,this._y3),this.point(this.
_x4,this._y4),this.point(this._x5,this._y5);break}}},point:function(x2,y2){if(x2=+x2,y2=+y2,this._point){var x23=this.
_x2-x2,y23=this._y2-y2;this._l23_a=Math.sqrt(this._l23_2a=Math.pow(x23*x23+y23*y23,this._alpha))}switch(this._point){case 0:
this._point=1,this._x3=x2,this._y3=y2;break;case 1:this._point=2,this._context.moveTo(this._x4=x2,this._y4=y2);
break;case 2:this._point=3,this._x5=x2,this._y5=y2;break;default:point$1(this,x2,y2);break}this._l01_a=this._l12_a,
this._l12_a=this._l23_a,this._l01_2a=this._l12_2a,this._l12_2a=this._l23_2a,this._x0=this._x1,this._x1=this._x2,
this._x2=x2,this._y0=this._y1,this._y1=this._y2,this._y2=y2}};catmullRomClosed=(function custom6(alpha){function catmullRom2(context){
return alpha?new CatmullRomClosed(context,alpha):new CardinalClosed(context,0)}return catmullRom2.alpha=function(alpha2){
return custom6(+alpha2)},catmullRom2})(.5);CatmullRomOpen.prototype={areaStart:function(){this._line=0},areaEnd:function(){
this._line=NaN},lineStart:function(){this._x0=this._x1=this._x2=this._y0=this._y1=this._y2=NaN,this._l01_a=this.
_l12_a=this._l23_a=this._l01_2a=this._l12_2a=this._l23_2a=this._point=0},lineEnd:function(){(this._line||this.
_line!==0&&this._point===3)&&this._context.closePath(),this._line=1-this._line},point:function(x2,y2){if(x2=+x2,
y2=+y2,this._point){var x23=this._x2-x2,y23=this._y2-y2;this._l23_a=Math.sqrt(this._l23_2a=Math.pow(x23*x23+y23*
y23,this._alpha))}switch(this._point){case 0:this._point=1;break;case 1:this._point=2;break;case 2:this._point=
3,this._line?this._context.lineTo(this._x2,this._y2):this._context.moveTo(this._x2,this._y2);break;case 3:this.
_point=4;default:point$1(this,x2,y2);break}this._l01_a=this._l12_a,this._l12_a=this._l23_a,this._l01_2a=this._l12_2a,
this._l12_2a=this._l23_2a,this._x0=this._x1,this._x1=this._x2,this._x2=x2,this._y0=this._y1,this._y1=this._y2,
this._y2=y2}};catmullRomOpen=(function custom7(alpha){function catmullRom2(context){return alpha?new CatmullRomOpen(
context,alpha):new CardinalOpen(context,0)}return catmullRom2.alpha=function(alpha2){return custom7(+alpha2)},
catmullRom2})(.5);LinearClosed.prototype={areaStart:noop,areaEnd:noop,lineStart:function(){this._point=0},lineEnd:function(){
this._point&&this._context.closePath()},point:function(x2,y2){x2=+x2,y2=+y2,this._point?this._context.lineTo(x2,
y2):(this._point=1,this._context.moveTo(x2,y2))}};MonotoneX.prototype={areaStart:function(){this._line=0},areaEnd:function(){
this._line=NaN},lineStart:function(){this._x0=this._x1=this._y0=this._y1=this._t0=NaN,this._point=0},lineEnd:function(){
switch(this._point){case 2:this._context.lineTo(this._x1,this._y1);break;case 3:point(this,this._t0,slope2(this,
this._t0));break}(this._line||this._line!==0&&this._point===1)&&this._context.closePath(),this._line=1-this._line},
point:function(x2,y2){var t1=NaN;if(x2=+x2,y2=+y2,!(x2===this._x1&&y2===this._y1)){switch(this._point){case 0:
this._point=1,this._line?this._context.lineTo(x2,y2):this._context.moveTo(x2,y2);break;case 1:this._point=2;break;case 2:
this._point=3,point(this,slope2(this,t1=slope3(this,x2,y2)),t1);break;default:point(this,this._t0,t1=slope3(this,
x2,y2));break}this._x0=this._x1,this._x1=x2,this._y0=this._y1,this._y1=y2,this._t0=t1}}};(MonotoneY.prototype=
Object.create(MonotoneX.prototype)).point=function(x2,y2){MonotoneX.prototype.point.call(this,y2,x2)};ReflectContext.
prototype={moveTo:function(x2,y2){this._context.moveTo(y2,x2)},closePath:function(){this._context.closePath()},
lineTo:function(x2,y2){this._context.lineTo(y2,x2)},bezierCurveTo:function(x1,y1,x2,y2,x3,y3){this._context.bezierCurveTo(
y1,x1,y2,x2,y3,x3)}};Natural.prototype={areaStart:function(){this._line=0},areaEnd:function(){this._line=NaN},
lineStart:function(){this._x=[],this._y=[]},lineEnd:function(){var x2=this._x,y2=this._y,n=x2.length;if(n)if(this.
_line?this._context.lineTo(x2[0],y2[0]):this._context.moveTo(x2[0],y2[0]),n===2)this._context.lineTo(x2[1],y2[1]);else
for(var px=controlPoints(x2),py=controlPoints(y2),i0=0,i1=1;i1<n;++i0,++i1)this._context.bezierCurveTo(px[0][i0],
py[0][i0],px[1][i0],py[1][i0],x2[i1],y2[i1]);(this._line||this._line!==0&&n===1)&&this._context.closePath(),this.
_line=1-this._line,this._x=this._y=null},point:function(x2,y2){this._x.push(+x2),this._y.push(+y2)}};Step.prototype=
{areaStart:function(){this._line=0},areaEnd:function(){this._line=NaN},lineStart:function(){this._x=this._y=NaN,
this._point=0},lineEnd:function(){0<this._t&&this._t<1&&this._point===2&&this._context.lineTo(this._x,this._y),
(this._line||this._line!==0&&this._point===1)&&this._context.closePath(),this._line>=0&&(this._t=1-this._t,this.
_line=1-this._line)},point:function(x2,y2){switch(x2=+x2,y2=+y2,this._point){case 0:this._point=1,this._line?this.
_context.lineTo(x2,y2):this._context.moveTo(x2,y2);break;case 1:this._point=2;default:{if(this._t<=0)this._context.
lineTo(this._x,y2),this._context.lineTo(x2,y2);else{var x1=this._x*(1-this._t)+x2*this._t;this._context.lineTo(
x1,this._y),this._context.lineTo(x1,y2)}break}}this._x=x2,this._y=y2}}}});function measure(words,font){return ruler.font=`${FONTS[font].join(" ")}px ${FAMILY}`,ruler.measureText(words).
width}function make(name,attributes){let made=document.createElementNS(SVG,name);for(let key in attributes)attributes[key]!==
void 0&&made.setAttribute(key,String(attributes[key]));return made}function add(name,attributes){let made=make(
name,attributes);return group.append(made),made}function into(inner,draw2){let outer=group;group=inner,draw2(),
group=outer}function drawOn(svg,[width,height],draw2){let drawn=document.createDocumentFragment();into(drawn,draw2),
svg.setAttribute("viewBox",`0 0 ${width.toFixed(2)} ${height.toFixed(2)}`),svg.replaceChildren(drawn)}function writeFigure(size,wide,[
title,description],read,draw2){let svg=make("svg",{width:`${wide}mm`,height:`${(wide*size[1]/size[0]).toFixed(
2)}mm`});return drawOn(svg,size,()=>{add("title",{}).textContent=title,add("desc",{}).textContent=description,
draw2()}),new XMLSerializer().serializeToString(svg).replace(/var\(--(\w+)\)/g,(_,name)=>read(name))}function text(words,[
x2,y2],{fill="label",font="small",align="middle",halo}={}){let[weight,size]=FONTS[font];add("text",{x:x2.toFixed(
2),y:(y2+MIDDLE2*size).toFixed(2),"font-family":FAMILY,"font-size":size,"font-weight":weight,"text-anchor":align,
fill:shade(fill),...halo&&{stroke:shade("halo"),"stroke-width":HALO,"stroke-linejoin":"round","paint-order":"s\
troke"}}).textContent=words}function within(box,draw2){let id=`clip-${clips+=1}`;add("clipPath",{id}).append(make(
"path",{d:traceBox(box)})),into(add("g",{"clip-path":`url(#${id})`}),draw2)}var FAMILY,SVG,HALO,MIDDLE2,FONTS,
ruler,group,clips,trace,traceBox,shade,path2,turned,init_sheet=__esm({"needlefit/viewer/page/sheet.js"(){"use \
strict";init_d3_shape();FAMILY="Arial, Liberation Sans, Helvetica, sans-serif",SVG="http://www.w3.org/2000/svg",
HALO=4,MIDDLE2=.35,FONTS={small:[400,11],plain:[400,12],strong:[600,12]},ruler=document.createElement("canvas").
getContext("2d"),group=document.createDocumentFragment(),clips=0;trace=places=>line()(places)??"",traceBox=({left,
top,width,height})=>`M${left},${top}h${width}v${height}h${-width}Z`;shade=name=>name&&`var(--${name})`,path2=(d,{
fill,stroke,width=1,dash,opacity})=>add("path",{d,opacity,fill:shade(fill)??"none",stroke:shade(stroke),"strok\
e-width":stroke&&width,"stroke-linejoin":stroke&&"round","stroke-dasharray":dash?.join(" ")});turned=([x2,y2],angle2,draw2)=>into(
add("g",{transform:`translate(${x2.toFixed(2)} ${y2.toFixed(2)}) rotate(${(-angle2*180/Math.PI).toFixed(2)})`}),
draw2)}});function look(window2,draw2){let kept={...view};Object.assign(view,window2);try{return draw2()}finally{Object.
assign(view,kept)}}function resize(width,height){view.box={left:GUTTER.left,top:GUTTER.top,width:Math.max(width-
GUTTER.left-GUTTER.right,10),height:Math.max(height-GUTTER.top-GUTTER.bottom,10)},fit(view.fit)}function fit(which){
if(view.fit=which,redraw(),!now.scene||!now.state||which==="moved")return;if(which==="tip"){let{x:x2,y:y2}=now.
state.tip;return Object.assign(view,{scale:view.box.width/TIP_WINDOW,magnified:1,x:x2,y:y2})}let[low,high,before,
after]=which==="whole"?[-now.scene.length_mm,deepest()+4,Math.min(74,.1*view.box.width+20),34]:[0,1.04*deepest(),
Math.min(44,.1*view.box.width),Math.min(84,.12*view.box.width)],room=view.box.width-before-after,[bottom,top]=heights(),
[along,across]=[room/(high-low),roomAcross()/(top-bottom)];view.scale=Math.min(along,across);let least2=LEAST_SPAN*
deepest(),times=roomAcross()/view.scale/Math.max(top-bottom,least2);view.magnified=MAGNIFICATIONS.filter(one=>one<=
times).at(-1)??1,view.x=(low+high)/2+(after-before)/(2*view.scale),view.y=(bottom+top)/2}function zoom(factor,[
px,py]=[toPx(view.x),toPy(view.y)]){let[x2,y2]=[fromPx(px),fromPy(py)];view.scale=Math.min(Math.max(view.scale*
factor,SCALES[0]),SCALES[1]),view.x+=x2-fromPx(px),view.y+=y2-fromPy(py),fit("moved")}function pan(px,py){view.
x-=px/view.scale,view.y+=py/(view.scale*view.magnified),fit("moved")}function deepest(){let{depth_mm:depth,boundaries_mm:tops,
measured}=now.scene,goals=goalCircles().map(([x2,,radius])=>x2+radius);return Math.max(depth,now.state.depth_mm,
(tops.at(-1)??0)+5,measured?.depth_mm??0,...goals)}function goalCircles(){let{plan}=now.scene;return plan?[[...plan.
target,plan.radius],...plan.obstacles.map(([x2,y2,radius])=>[x2,y2,radius])]:[]}function heights(){let{state,band,
pinned,scene:{measured}}=now,seen=[state,pinned].flatMap(one=>one?one.y.filter((_,i)=>view.fit==="whole"||one.
x[i]>=0):[]),goals=goalCircles().flatMap(([,y2,radius])=>[y2-radius,y2+radius]);return extent([...seen,...measured?.
y??[],...goals,...band?.low??[],...band?.high??[],0])}function seesTip(){let{left,top,width,height}=view.box,{
x:x2,y:y2}=now.state.tip,[px,py]=[toPx(x2)-left,toPy(y2)-top];return px>=0&&px<=width&&py>=0&&py<=height}function follow(){
let anew=view.of!==now.scene;if(view.of=now.scene,view.fit==="moved"&&!anew)return;if(anew||view.fit==="tip")return fit(
view.fit==="moved"?"tissue":view.fit);let[bottom,top]=heights(),px=view.scale*view.magnified,out=Math.max(top-
view.y,view.y-bottom)*px>roomAcross()/2+1||!seesTip(),low=(top-bottom)*px<LOW2*roomAcross();(out||low&&view.magnified<
MAGNIFICATIONS[MAGNIFICATIONS.length-1])&&fit(view.fit)}var GUTTER,MAGNIFICATIONS,ROOM,LEAST_SPAN,LOW2,TIP_WINDOW,
SCALES,view,toPx,toPy,fromPx,fromPy,roomAcross,init_view=__esm({"needlefit/viewer/page/view.js"(){"use strict";
init_d3_array();init_store();GUTTER={left:56,right:10,top:50,bottom:40},MAGNIFICATIONS=[1,1.5,2,3,4,5,6,8,10,12,
15,20,30,50],ROOM=56,LEAST_SPAN=.01,LOW2=.45,TIP_WINDOW=45,SCALES=[.5,400],view={x:0,y:0,scale:5,magnified:1,fit:"\
tissue",of:null,box:{left:0,top:0,width:1,height:1}};Object.assign(now,{view});toPx=x2=>view.box.left+view.box.
width/2+(x2-view.x)*view.scale,toPy=y2=>view.box.top+view.box.height/2-(y2-view.y)*view.scale*view.magnified,fromPx=
px=>view.x+(px-view.box.left-view.box.width/2)/view.scale,fromPy=py=>view.y-(py-view.box.top-view.box.height/2)/
(view.scale*view.magnified);roomAcross=()=>view.box.height-2*Math.min(ROOM,.2*view.box.height);listen("band",follow)}});function haloed(curve,shade2,width,dash){let places=[placesOf(curve)];polyline(places,"halo",width+2),polyline(
places,shade2,width,dash)}function avoid(places){for(let[px,py]of places){let[left,top]=now.avoided.at(-1)??[-1/0,
0];Math.hypot(px-4-left,py-4-top)>8&&now.avoided.push([px-4,py-4,8,8])}}function labelFree(words,places,fill){
let{left,top,width,height}=view.box,wide=measure(words,"strong")+6,limit=(value,low,high)=>Math.max(low,Math.min(
value,high)),free=places.map(([px,py])=>[limit(px-wide/2,left+2,left+width-wide-2),limit(py-LINE/2,top+2,top+height-
LINE-2),wide,LINE]).filter(one=>!count(now.labels,one)),box=least(free,one=>count(now.avoided,one));box&&(now.
labels.push(box),text(words,[box[0]+wide/2,box[1]+LINE/2],{fill,font:"strong",halo:!0}))}function labelBeside(words,sides,shade2){
let half=measure(words,"strong")/2,curves=sides.map(([curve,away])=>({places:placesOf(curve),away}));for(let{places}of curves)
avoid(places);let ends=curves.map(({places})=>places[places.length-1]).map(([px,py])=>[px+half+8,py]),beside=SHARES.
flatMap(share=>curves.flatMap(({places,away})=>{let[px,py]=places[Math.round(share*(places.length-1))];return[
0,-half,half].map(aside=>[px+aside,py+away])}));labelFree(words,[...ends,...beside],shade2)}var polyline,polygon,
placesOf,traceBetween,cross,traceEllipse,LINE,SHARES,clearLabels,overlap,count,countBelow,nameLine,init_strokes=__esm(
{"needlefit/viewer/page/painters/strokes.js"(){"use strict";init_d3_array();init_d3_shape();init_sheet();init_store();
init_view();polyline=(lines,stroke,width,dash)=>path2(lines.map(trace).join(""),{stroke,width,dash}),polygon=(corners,fill,opacity)=>path2(
`${trace(corners)}Z`,{fill,opacity}),placesOf=({x:x2,y:y2})=>x2.map((one,i)=>[toPx(one),toPy(y2[i])]);traceBetween=
(x2,low,high)=>area().x((_,i)=>toPx(x2[i])).y0((_,i)=>toPy(low[i])).y1((_,i)=>toPy(high[i]))(x2)??"",cross=([px,
py],arm,oblique=!1)=>[[arm,oblique?arm:0],[oblique?-arm:0,arm]].map(([dx,dy])=>[[px-dx,py-dy],[px+dx,py+dy]]),
traceEllipse=([px,py],along,across)=>`M${px-along},${py}a${along},${across} 0 1 0 ${2*along},0a${along},${across}\
 0 1 0 ${-2*along},0Z`,LINE=16,SHARES=[1,.8,.6,.4],clearLabels=()=>Object.assign(now,{labels:[],avoided:[]}),overlap=
([x2,y2,w,h],[x22,y22,w2,h2])=>x2<x22+w2&&x22<x2+w&&y2<y22+h2&&y22<y2+h,count=(places,box)=>places.filter(one=>overlap(
one,box)).length,countBelow=box=>count([...now.labels,...now.avoided],box);nameLine=(words,curve,shade2)=>labelBeside(
words,[[curve,16],[curve,-16]],shade2)}});function paintTissue(){let{box}=view;path2(traceBox(box),{fill:"air"});let layers=listLayers(),[soft,stiff]=extent(
now.state.layers,({mu_pa:mu})=>Math.log10(mu));for(let{from,to,mu}of layers){let edges=traceBox({...box,left:from,
width:to-from});path2(edges,{fill:"soft"}),path2(edges,{fill:"stiff",opacity:(Math.log10(mu)-soft)/Math.max(stiff-
soft,1)})}for(let{from,number:number2,top:edge}of layers){if(edge<box.left)continue;let[fill,width]=number2===
1?["ink",1.5]:["edge",1];path2(traceBox({...box,left:Math.round(from)-.5,width}),{fill})}let axis=Math.round(toPy(
0))+.5;polyline([[[box.left,axis],[box.left+box.width,axis]]],"quiet",1,[5,4])}function listLayers(){let{boundaries_mm:tops,
layer_names:names}=now.scene,{left,width}=view.box,depths=[0,...tops,1/0];return now.state.layers.map(({mu_pa:mu},i)=>({
mu,number:i+1,name:names[i]||`layer ${i+1}`,top:toPx(depths[i]),from:Math.max(toPx(depths[i]),left),to:Math.min(
toPx(depths[i+1]),left+width)})).filter(({from,to})=>to>from)}function paintNames(){let{left,top,width}=view.box,
layers=listLayers(),write2=(texts,py)=>{let end=-1/0;texts.forEach((words,i)=>{let middle=(layers[i].from+layers[i].
to)/2,half=measure(words,"plain")/2;middle-half<end+APART||(text(words,[middle,top+py],{font:"plain"}),end=middle+
half)})},named=layers.every(({from,to,name})=>measure(name,"plain")<=to-from);write2(layers.map(({name,number:number2})=>named?
name:String(number2)),-27),write2(layers.map(({mu})=>`μ ${modulus(mu)}`),-11);let skin=toPx(0);skin>left+40&&
skin<=left+width&&text("skin",[skin-4,top-11],{font:"plain",align:"end"})}function paintFrame(name){let{left,top,
width,height}=view.box;path2(traceBox({left:left-.5,top:top-.5,width:width+1,height:height+1}),{stroke:"quiet"});
let across=ticks(fromPy(top+height),fromPy(top),Math.max(height/TICKS_APART,2)).map(y2=>[y2,Math.round(toPy(y2))+
.5]);polyline(across.map(([,py])=>[[left-TICK,py],[left,py]]),"quiet",1);for(let[y2,py]of across)text(written2(
y2),[left-TICK-2,py],{align:"end"});turned([11,top+height/2],QUARTER,()=>text(name,[0,0]))}function paintAxes(){
let{left,top,width,height}=view.box,bottom=top+height;paintFrame(nameAcross(height)),paintNames();let along=ticks(
fromPx(left),fromPx(left+width),width/TICKS_APART).map(x2=>[x2,Math.round(toPx(x2))+.5]);polyline(along.map(([
,px])=>[[px,bottom],[px,bottom+TICK]]),"quiet",1);for(let[x2,px]of along)text(written2(x2),[px,bottom+TICK+8]);
text("x along the entry (mm)",[left+width/2,bottom+31])}function nameAcross(room){if(view.magnified===1)return"\
y (mm)";let long=`y (mm), drawn ${view.magnified}× as large as x`;return measure(long,"small")<room?long:`y (\
mm), drawn ${view.magnified}×`}var APART,TICK,TICKS_APART,QUARTER,written2,init_background=__esm({"needlefit/\
viewer/page/painters/background.js"(){"use strict";init_d3_array();init_quantities();init_sheet();init_store();
init_view();init_strokes();APART=8,TICK=5,TICKS_APART=60,QUARTER=Math.PI/2;written2=value=>brief(value,6).replace(
"-","−")}});function computeValidity(shape,{boundaries,thickness,spacing}){let{x:x2,u,slope:slope4,planes,track}=shape,last3=x2.
length-1,bent=Array.from({length:planes},(_,p)=>[u,slope4].map(one=>one.subarray(p*x2.length,(p+1)*x2.length))),
cubics=bent.map(()=>[0,0,0]),[rotations,missed]=[bent.map(()=>0),bent.map(()=>0)],rotate=t=>(cubics.forEach(([
begin2,bend,curl],p)=>rotations[p]=begin2+t*(bend+t*curl)),measure2(rotations)),steepest=0,shortening=0,miss=0;
for(let i=0;i<=last3;i+=1)steepest=Math.max(steepest,measure2(bent.map(([,one])=>one[i])));for(let i=0;i<last3;i+=
1){let step=x2[i+1]-x2[i];bent.forEach(([v,rotation],p)=>{let mean2=(v[i+1]-v[i])/step,begin2=rotation[i],end=rotation[i+
1];cubics[p]=[begin2,6*mean2-4*begin2-2*end,3*(begin2+end)-6*mean2]});let[[,bend,curl]]=cubics,inside=planes>1?
[.25,.5,.75]:[Math.abs(curl)>1e-12?-.5*bend/curl:0];for(let at of inside)at>0&&at<1&&(steepest=Math.max(steepest,
rotate(at)));for(let[t,weight]of GAUSS){let angle2=rotate(t);shortening+=step*weight*2*Math.sin(angle2/2)**2,x2[i]<
-1e-9&&angle2&&rotations.forEach((one,p)=>missed[p]+=step*weight*one*(1-Math.sin(angle2)/angle2))}miss=Math.max(
miss,measure2(missed))}for(let i=0;i<track.length;i+=2*planes)steepest=Math.max(steepest,measure2(bent.map((_,p)=>track[i+
2*p+1])));let entered=1+boundaries.filter(end=>end<x2[last3]).length,widths=boundaries.slice(0,entered).map((end,i)=>end-
(i?boundaries[i-1]:0)).filter(width=>width>0),thinnest=widths.length?Math.max(Math.min(...widths),spacing):1/0;
return{max_slope:steepest,deflection_per_length:measure2(bent.map(([v])=>Math.max(...v)-Math.min(...v)))/(x2[last3]-
x2[0]),shortening_per_layer:shortening/thinnest,miss_mm:miss,compression:Math.max(...listGaps(shape).map(measure2))/
Math.min(...thickness.slice(0,entered))}}function listGaps({x:x2,u,slope:slope4,planes,constraints}){let i=0;return Array.
from({length:constraints.length/(1+planes)},(_,k2)=>{let[at,...places]=constraints.subarray((1+planes)*k2,(1+planes)*
(k2+1));for(;i<x2.length-2&&x2[i+1]<at-1e-9;)i+=1;let span=x2[i+1]-x2[i],t=Math.min(Math.max((at-x2[i])/span,0),
1);return places.map((place,p)=>{let n=p*x2.length+i,bend=3*(u[n+1]-u[n])-span*(2*slope4[n]+slope4[n+1]),curl=2*
(u[n]-u[n+1])+span*(slope4[n]+slope4[n+1]);return u[n]+t*(span*slope4[n]+t*(bend+t*curl))-place})})}var GAUSS,
measure2,listFaults,init_validity=__esm({"needlefit/viewer/page/model/validity.js"(){"use strict";GAUSS=[[.5-Math.
sqrt(.15),.2777777777777778],[.5,.4444444444444444],[.5+Math.sqrt(.15),.2777777777777778]],measure2=parts=>parts.
length>1?Math.sqrt(parts[0]**2+parts[1]**2):Math.abs(parts[0]);listFaults=(validity,limits)=>limits.filter(([name,
limit])=>!(validity[name]<=limit)).map(([name,limit,words])=>{let unit=name.endsWith("_mm")?" mm":"";return`${words}\
 ${Number(validity[name].toPrecision(3))}${unit} (limit ${limit}${unit})`})}});function describeState(steered){let{scene,session,model,names,rules}=steered,{shape,depth,inputs:{bevel,base,guides,
tip}}=session,validity=computeValidity(shape,model),[x2,y2,z=null]=columns(session.positions(listStations(shape)),
1+shape.planes),last3=shape.x.length-1,roll2=wrap(rollOf(bevel));return{step:steered.number,depth_mm:depth,x:x2,
y:y2,z,...placePoints(session),base:{x:x2[0],y:y2[0],rotation:shape.slope[0],input_y:base.y,input_slope:base.slope},
guides:guides.map(({name,x:x3,y:y3,slope:slope4})=>({item:guideNumber(name,names),name,x:x3,y:y3,slope:slope4??
0,turns_freely:slope4===null})),tip:{x:x2[x2.length-1],y:y2[y2.length-1],z:z&&z[z.length-1],rotation:shape.slope[last3],
lateral_mm:y2[y2.length-1],held:tip!==null,input_y:shape.u[last3]},bevel:{side:Math.abs(roll2)>90?-1:1,roll_deg:roll2,
...model.pathAngle?{cut_angle_deg:bevel.strength*(180/Math.PI)}:{offset_mm:bevel.strength}},layers:model.mu.map(
(mu,layer)=>({mu_pa:mu*1e6,...Object.fromEntries(scene.shape_parameters.map(({name},row)=>[name,model.shape[row][layer]]))})),
max_slope:validity.max_slope,faults:listFaults(validity,rules.validity),errors:scene.measured&&computeErrors(session,
scene.measured)}}function placePoints(session){let{planes,constraints,track}=session.shape,cut=columns(constraints,
1+planes),[x2,...needle]=columns(session.positions(cut[0]),1+planes),gaps=columns(listGaps(session.shape).flat(),
planes),tip=columns(track,2*planes),points=needle.map((row,p)=>row.map((place,i)=>place-gaps[p][i])),path3=points.
map((row,p)=>row.map((place,i)=>place+tip[2*p][i]-cut[1+p][i])),curve=([y2,z])=>({x:x2,y:y2,z});return{constraints:curve(
points),tip_path:curve(path3)}}function describeLoad({session,model}){let{depth,planes}=session.shape,count2=Math.
ceil(SAMPLES*depth/model.spacing),s2=Array.from({length:count2+1},(_,i)=>depth*(i/(count2||1))),[x2,y2]=columns(
session.positions(s2),1+planes),loads=session.load(s2),means=Array.from({length:planes},(_,p)=>loads.subarray(
p*s2.length,(p+1)*s2.length)).map(row=>{let sums=[0];for(let value of row)sums.push(sums[sums.length-1]+value);
return s2.map((_,i)=>{let half=Math.min(SAMPLES,i,count2-i);return(sums[i+half+1]-sums[i-half])/(2*half+1)})});
return{x:x2,y:y2,load:planes===1?means[0]:means[0].map((one,i)=>Math.hypot(one,means[1][i]))}}function listStations({
x:x2,depth}){let end=Math.min(0,depth),before=Array.from({length:POINTS_BEFORE_TISSUE},(_,i)=>x2[0]+(end-x2[0])*
i/(POINTS_BEFORE_TISSUE-1));return before[POINTS_BEFORE_TISSUE-1]=end,Float64Array.from(new Set([...before,...x2])).
sort()}var POINTS_BEFORE_TISSUE,SAMPLES,columns,init_state=__esm({"needlefit/viewer/page/model/state.js"(){"us\
e strict";init_bevel();init_inputs();init_errors();init_validity();POINTS_BEFORE_TISSUE=25,SAMPLES=8,columns=(points,width)=>Array.
from({length:width},(_,axis)=>Array.from({length:points.length/width},(_2,i)=>points[width*i+axis]))}});function paintNeedle({x:x2,y:y2,faults,bevel:{side}}){let points=placesOf({x:x2,y:y2}),tip=points[points.length-
1],shaft=points.filter(one=>distance(one,tip)>BEVEL.length),last3=shaft.at(-1)??tip,share=1-BEVEL.length/(distance(
last3,tip)||1),end=last3.map((from,i)=>from+share*(tip[i]-from));polyline([[...shaft,end]],faults.length?"bad":
"needle",LINE2,faults.length?[9,5]:[]);let size=distance(end,tip)||1,[dx,dy]=tip.map((to,i)=>BEVEL.half*(to-end[i])/
size),aside=([px,py],to)=>[px+to*dy,py-to*dx],[back,near2,point2]=[aside(end,-side),aside(end,side),aside(tip,
side)];polygon([back,near2,point2],"needle"),polyline([[back,point2]],"tip",2)}function paintPoints({constraints:{
x:x2,y:y2}}){let half=Math.min(Math.max(CROSS.of*now.scene.spacing_mm*view.scale,CROSS.least),CROSS.most);polyline(
placesOf({x:x2,y:y2}).flatMap(place=>cross(place,half,!0)),"points",1.2),nameLine("constraint points",{x:x2,y:y2},
"points")}function paintPath({tip_path:curve}){polyline([placesOf(curve)],"path",1.5),nameLine("tip path",curve,
"path")}function paintLoad(){let{x:x2,y:y2,load:load2}=describeLoad(now.steered),greatest=max(load2,Math.abs);
if(!greatest)return;let[,top]=nice(0,greatest,1),{box}=view,tall=Math.min(TALLEST,.2*box.height-10),shaft=placesOf(
{x:x2,y:y2}),edge=shaft.map(([px,py],i)=>[px,py-tall*load2[i]/top]);polygon([...shaft,...edge.toReversed()],"l\
oad",.32),polyline([edge],"load",1.25);let[left,high]=[box.left+10,box.top+6],ends=[high,high+tall].map(py=>[[
left-4,py],[left+4,py]]);polyline([[[left,high],[left,high+tall]],...ends],"load",1.5);let words=`load ${brief(
top)} N/mm`;now.labels.push([left-4,high,measure(words,"small")+16,tall]),text(words,[left+8,high+tall/2],{fill:"\
load",align:"start",halo:!0})}function paintBase({base}){let[px,py]=[toPx(base.x),toPy(base.y)],ends=[-46,46].
map(to=>[[px-5,py+to],[px+5,py+to]]);polyline([[[px,py-46],[px,py+46]],...ends],"quiet",2),turned([px,py],angleOf(
Math.tan(base.rotation)),()=>path2("M-22,-7h26v14h-26Z",{fill:"ink"}))}function paintGuides({guides}){for(let guide of guides){
let[px,py]=[toPx(guide.x),toPy(guide.y)];turned([px,py],angleOf(guide.slope),()=>{for(let to of[-1,1]){let d=guide.
turns_freely?`M0,${GAP*to}l-7,${11*to}h14Z`:`M-13,${GAP*to}h26v${7*to}h-26Z`;path2(d,{fill:"guide"})}}),px>=view.
box.left&&px<=view.box.left+view.box.width&&labelFree(shortName(guide),[[px,py+27]],"guide")}}var LINE2,BEVEL,
GAP,CROSS,TALLEST,angleOf,distance,init_needle2=__esm({"needlefit/viewer/page/painters/needle.js"(){"use stric\
t";init_d3_array();init_state();init_quantities();init_sheet();init_store();init_view();init_strokes();LINE2=2.5,
BEVEL={length:7.5,half:1.5},GAP=3,CROSS={of:.28,least:1,most:3.2},TALLEST=36,angleOf=slope4=>Math.atan(slope4*
view.magnified),distance=(one,other)=>Math.hypot(one[0]-other[0],one[1]-other[1])}});function paintCompared(words,curve,shade2,width,dash){isTip(curve)?path2(traceEllipse(placesOf(curve)[0],DOT,DOT),
{fill:"halo",stroke:shade2,width:2}):haloed(curve,shade2,width,dash),nameLine(isTip(curve)?`${words} tip`:words,
curve,shade2)}function nameNeedle(state){predictionOf(state,now.scene)||nameLine(isSteered(state,now.scene)?"s\
teered":"simulated",state,state.faults.length?"bad":"needle")}function nameBand({x:x2,low,high}){isChanged(now.
state,now.scene)&&labelBeside("band of the fit",[[{x:x2,y:high},-14],[{x:x2,y:low},14]],"band")}function paintBand({
x:x2,low,high},pale){path2(traceBetween(x2,low,high),{fill:"band",opacity:pale?.16:.4});for(let edge of[low,high])
polyline([placesOf({x:x2,y:edge})],"band",pale?.75:1.5)}function paintGaps(state,measured){let{errors}=state;if(!errors)
return;let prediction=predictionOf(state,now.scene),needle=prediction??state,[tip,other]=[needle,measured].map(
({x:x2,y:y2})=>({x:x2[x2.length-1],y:y2[y2.length-1]})),reach=Math.min(tip.x,other.x),across=x2=>[needle,measured].
map(curve=>[toPx(x2),toPy(interpolate(curve.x,curve.y,x2))]),places=isTip(measured)?[]:range(1,GAPS).map(n=>reach*
n/GAPS);polyline(places.map(across),"gap",1.25);let te=(prediction?.errors??errors).te_mm;if(te===null)return;
measured.tip&&([[other.x],[other.y]]=[measured.tip.x,measured.tip.y]);let ends=errors.whole?[tip,other].map(({
x:x2,y:y2})=>[toPx(x2),toPy(y2)]):across(reach);for(let[shade2,width]of[["halo",5],["gap",2.5]])polyline([ends],
shade2,width);let px=ends[1][0],[top,bottom]=extent(ends,([,py])=>py),beside=[0,60,-90].flatMap(aside=>[top-AWAY,
bottom+AWAY].map(py=>[px+aside,py]));labelFree(`tip error (TE) ${te.toFixed(2)} mm`,beside,"gap")}function paintPlan({
target:[x2,y2],radius,obstacles,needles}){for(let[xs,ys]of needles)path2(trace(placesOf({x:xs,y:ys})),{stroke:"\
plan",opacity:FAN});for(let[along,across,size,name]of obstacles)paintCircle(along,across,size,"tip",name,.28);
paintCircle(x2,y2,radius,"guide","target"),polyline(cross([toPx(x2),toPy(y2)],CROSS2),"guide",2)}function paintCircle(x2,y2,radius,shade2,name,opacity=0){
let[px,size]=[toPx(x2),radius*view.scale],edge=traceEllipse([px,toPy(y2)],size,size*view.magnified);path2(edge,
{fill:shade2,opacity}),path2(edge,{stroke:"halo",width:4}),path2(edge,{stroke:shade2,width:2}),!(px<view.box.left||
px>view.box.left+view.box.width)&&labelFree(name,[[px,toPy(y2+radius)-12],[px,toPy(y2-radius)+12]],shade2)}function paintInset({
x:x2,y:y2}){let points=range(x2.length).filter(i=>x2[i]>=0);if(points.length<2)return;let{box}=view,{diameter_mm:thick}=now.
scene,[first,last3]=[x2[points[0]],x2[x2.length-1]],[low,high]=extent(points,i=>y2[i]),scale=Math.min(INSET.width*
box.width/(last3-first+thick),INSET.height*box.height/(high-low+thick)),size={width:(last3-first+thick)*scale+
2*INSET.edge,height:(high-low+thick)*scale+INSET.edge+INSET.title},corners=[box.top+box.height-size.height-INSET.
edge,box.top+INSET.edge].flatMap(top=>[box.left+INSET.edge,box.left+box.width-size.width-INSET.edge].map(left=>({
left,top,...size}))),frame2=least(corners,({left,top})=>countBelow([left,top,size.width,size.height]));now.labels.
push([frame2.left,frame2.top,size.width,size.height]),path2(traceBox(frame2),{fill:"air",stroke:"quiet"});let place=i=>[
frame2.left+INSET.edge+(x2[i]-first+thick/2)*scale,frame2.top+INSET.title+(high-y2[i]+thick/2)*scale];polyline(
[points.map(place)],"needle",Math.max(thick*scale,1)),text("true scale",[frame2.left+6,frame2.top+INSET.title/
2],{align:"start",halo:!0})}var GAPS,FAN,CROSS2,DOT,AWAY,BAND_REACH,INSET,isTip,isBandNear,init_overlay=__esm(
{"needlefit/viewer/page/painters/overlay.js"(){"use strict";init_d3_array();init_errors();init_quantities();init_sheet();
init_store();init_view();init_strokes();GAPS=12,FAN=.3,CROSS2=5,DOT=4,AWAY=19,BAND_REACH=2,INSET={width:.3,height:.25,
edge:10,title:16},isTip=({x:x2})=>x2.length===1;isBandNear=({x:x2},state)=>x2.length>0&&Math.abs(x2[x2.length-
1]-state.tip.x)<=BAND_REACH}});function listShown(){let{state,shown:shown2,scene,band,pinned}=now;return{state,band:shown2.band&&band&&isBandNear(
band,state)?band:null,measured:shown2.measured?scene.measured:null,pinned:shown2.pinned?pinned:null}}function paintCurves({
state,band,measured,pinned},below,above){let{shown:shown2}=now;within(view.box,()=>{paintTissue(),band&&paintBand(
band,band.step!==state.step),below(),pinned&&paintCompared("pinned",pinned,"pinned",2.5,[2,3]),paintNeedle(state),
shown2.path&&paintPath(state),shown2.points&&paintPoints(state),measured&&paintCompared("measured",measured,"m\
easured",2,[7,4]),measured?.tip&&paintCompared("measured",measured.tip,"measured",2),above()})}function begin([
width,height]){path2(traceBox({left:0,top:0,width,height}),{fill:"gutter"}),clearLabels()}function paintPicture(size){
let{shown:shown2,scene}=now,{plan}=scene,prediction=predictionOf(now.state,scene),seen=listShown(),{state,band,
measured,pinned}=seen;begin(size);for(let curve of[state,measured,pinned])curve&&avoid(placesOf(curve));paintCurves(
seen,()=>{shown2.load&&!state.faults.length&&paintLoad(),shown2.plan&&plan&&paintPlan(plan)},()=>{prediction&&
paintCompared("predicted",prediction,"accent",2.5),measured&&shown2.errors&&paintGaps(state,measured),paintGuides(
state),paintBase(state),(measured||pinned)&&nameNeedle(state),band&&nameBand(band),shown2.inset&&paintInset(state)}),
paintAxes()}function paintAbove([width,height]){let{state,band,measured,pinned}=listShown();begin([width,height]);
let seen={state:{...turn(state),constraints:turn(state.constraints),tip_path:turn(state.tip_path),bevel:{...state.
bevel,side:Math.sin(state.bevel.roll_deg*Math.PI/180)<0?-1:1}},band:band?.z?{...band,...band.z}:null,measured:measured&&
{...turn(measured),tip:measured.tip&&turn(measured.tip)},pinned:pinned&&turn(pinned)},heights2=[seen.state,seen.
measured,seen.pinned].flatMap(curve=>curve?.y??[]),[low,high]=extent([...heights2,...seen.band?[...seen.band.low,
...seen.band.high]:[],0]),box={...view.box,top:EDGE,height:height-2*EDGE},magnified=Math.min(view.magnified,(box.
height-2*ROOM2)/(view.scale*(high-low||1)));look({y:(low+high)/2,box,magnified},()=>{paintCurves(seen,()=>{},()=>text(
"from above",[box.left+6,EDGE+10],{align:"start",halo:!0})),paintFrame(magnified===1?"z (mm)":`z (mm), drawn ${brief(
magnified,2)}×`)})}var EDGE,ROOM2,isSpatial,turn,init_picture=__esm({"needlefit/viewer/page/painters/picture.\
js"(){"use strict";init_d3_array();init_quantities();init_sheet();init_store();init_view();init_background();init_needle2();
init_overlay();init_strokes();[EDGE,ROOM2]=[8,14],isSpatial=()=>!!(now.state?.z??now.scene?.measured?.compared===
"space");turn=curve=>({...curve,y:curve.z??curve.x.map(()=>0)})}});function draw(){if(frame=0,now.state){let above=part("above");above.toggleAttribute("hidden",!isSpatial()),isSpatial()&&
drawOn(above,sizeOf(above),()=>paintAbove(sizeOf(above))),drawOn(picture,sizeOf(picture),()=>paintPicture(sizeOf(
picture)))}publish("drawn")}var NOTCHES,picture,frame,sizeOf,last,init_drawing=__esm({"needlefit/viewer/page/d\
rawing.js"(){"use strict";init_dom();init_picture();init_sheet();init_store();init_view();NOTCHES=[300,10,2],picture=
part("picture"),frame=0,sizeOf=({clientWidth,clientHeight})=>[clientWidth,clientHeight];listen("redraw",()=>frame||=
requestAnimationFrame(draw));listen("state",()=>(follow(),redraw()));listen("band",redraw);new ResizeObserver(
()=>resize(...sizeOf(picture))).observe(picture);new ResizeObserver(redraw).observe(part("above"));last=[0,0];
picture.addEventListener("pointerdown",({pointerId})=>picture.setPointerCapture(pointerId));picture.addEventListener(
"pointermove",({buttons,pointerType,offsetX,offsetY})=>{buttons===1&&pointerType!=="touch"&&pan(offsetX-last[0],
offsetY-last[1]),last=[offsetX,offsetY]});picture.addEventListener("wheel",event=>{document.activeElement!==picture&&
!event.ctrlKey||(event.preventDefault(),zoom(2**(-event.deltaY/NOTCHES[event.deltaMode]),[event.offsetX,event.
offsetY]))},{passive:!1});picture.addEventListener("dblclick",()=>fit("tissue"))}});async function unpack(id){let bytes=Uint8Array.from(atob(part(id).textContent),one=>one.charCodeAt(0)),stream=new Blob(
[bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));return new Response(stream).arrayBuffer()}
async function load(){let[data,kernel]=await Promise.all([unpack("data"),unpack("kernel").then(compile)]),{lists,
...read}=JSON.parse(new TextDecoder().decode(data));for(let{scene:{draws}}of read.needles)for(let name in draws)
draws[name]=lists[draws[name]?.$]??draws[name];return{...read,kernel}}function insert(steered){for(let changes of steered.
scene.simulation.changes)steered.apply(changes)}function compareStored(steered,{errors:known,tip},same){let{scene:{
measured},session}=steered;if(!known||!measured?.stored)return Math.abs(steered.tipLateral-Number(tip));let{x:x2,
y:y2,z}=measured.stored,[points]=readTarget(session,measured.target),computed=computeErrors(session,measured),
errors=Object.keys(known).map(name=>Math.abs(known[name]-computed?.[name]));return Math.max(...points.flatMap(
(point2,i)=>[x2,y2,z].map((axis,n)=>Math.abs(point2[n]-axis[i]))),...errors.filter(one=>one>same))}async function prove({
needles,kernel},same){let[count2,largest,since]=[0,0,performance.now()],rest=async()=>{performance.now()-since<
SLICE||(await new Promise(done=>setTimeout(done)),since=performance.now())};for(let needle of needles){let compare=distance2=>{
count2+=1,largest=Math.max(largest,distance2)};try{let steered=await SteeredNeedle.begin(kernel,needle.scene);
if(needle.recording){let replay=new Replay(steered,needle.recording);for(let n=1;n<=needle.recording.length;n+=
1)replay.to(n),compare(Math.abs(steered.tipLateral-needle.recording[n-1][2])),await rest()}else{if(insert(steered),
needle.tip===null)continue;compare(compareStored(steered,needle,same))}}catch(error){if(!(error instanceof ModelError))
throw error;compare(NaN)}await rest()}return{count:count2,largest}}var SLICE,Replay,init_stored=__esm({"needle\
fit/viewer/page/stored.js"(){"use strict";init_needle();init_dom();init_errors();init_inputs();init_steered();
SLICE=12;Replay=class{at=0;changed=!1;constructor(steered,steps2,places=[],unit="s"){this.steered=steered,this.
steps=steps2,this.places=places,this.unit=unit;let changes=steps2.flatMap(([,changes2])=>changes2);this.returns=
new Set(changes.flatMap(([name,,value])=>name==="return_to"?[value]:[]))}to(n){let{steered,steps:steps2,returns}=this;
for((this.changed||n<this.at)&&(steered.rewind(),Object.assign(this,{at:0,changed:!1}));this.at<n;this.at+=1)returns.
has(this.at)&&steered.keep(),steered.apply(steps2[this.at][1])}}}});function refuse(error,below=part("flip").parentElement){if(!(error instanceof ModelError))throw error;below.after(
refusal),write(refusal,`${error.what}. Expected: ${error.expected}.`)}function show(){steps+=1,part("undo").disabled=
!past.length,part("redo").disabled=!future.length,take("state",{...describeState(now.steered),step:steps})}function forgetPast(){
for(let one of[past,future])one.length=0;last2=0,write(refusal,"")}function goHome(){forgetPast(),now.steered.
rewind();try{insert(now.steered)}catch(error){refuse(error)}show()}function steer(lists,{gesture:gesture2=newGesture(),
whole=!1,below}={}){let{steered}=now,{number:number2}=steered;publish("steers"),write(refusal,"");let begins=gesture2!==
last2;(begins||whole)&&steered.keep();try{for(let changes of lists)steered.apply(changes.map(([name,item,value])=>[
name,item,value+0]))}catch(error){if(refuse(error,below),whole&&steered.number>number2&&steered.apply([["retur\
n_to",null,number2]]),whole||steered.number===number2)return void publish("unchanged")}begins&&(past.push(number2),
future.length=0),last2=gesture2,part("back").disabled=!1,show()}function goTo(from,to){let number2=from.pop();
if(number2===void 0)return;publish("steers"),write(refusal,"");let{steered}=now;steered.keep(),to.push(steered.
number),steered.apply([["return_to",null,number2]]),last2=0,show()}var refusal,past,future,steps,gestures,last2,
newGesture,change,undo,redo,init_steering=__esm({"needlefit/viewer/page/steering.js"(){"use strict";init_dom();
init_inputs();init_state();init_stored();init_store();refusal=part("refusal"),[past,future]=[[],[]],[steps,gestures,
last2]=[0,0,0],newGesture=()=>gestures+=1;change=(changes,how)=>steer([changes],how);undo=()=>goTo(past,future),
redo=()=>goTo(future,past)}});function save(content,type,ending){let name=`${nameOf2(now.needle).replace(/[^\w-]+/g,"-")}.${ending}`,link=element(
"a",{href:URL.createObjectURL(new Blob([content],{type})),download:name});return link.click(),setTimeout(()=>URL.
revokeObjectURL(link.href),1e4),name}async function followAddress(choose2){let address=location.hash.slice(1);
if(!address||document.querySelector(":target"))return!1;let{needles}=now.data,below=part("proof").parentElement;
try{let name=nameIn(address),number2=needles.findIndex(one=>nameOf2(one)===name);if(name!==null&&number2<0)throw new ModelError(
`the address has needle=${name}`,needles.map(nameOf2).join(", "));number2>=0&&needles[number2]!==now.needle&&await choose2(
number2);let lists=readAddress(address,now.scene);return lists.length&&steer(lists,{below,whole:!0}),lists.length>
0}catch(error){return refuse(error,below),!0}}async function copy(){let{data:{needles,kernel},needle,scene,steered}=now,
address=await writeAddress(kernel,steered,needles.length>1?nameOf2(needle):null);write("link-note",address?"":
"No link: an address carries depth, roll and turns of the bevel, and parameters. A recording carries all input\
s."),address&&(steer(readAddress(address,scene)),history.replaceState(null,"",`#${address}`),await navigator.clipboard?.
writeText(location.href).then(()=>write("link-note","The link is copied."),()=>null))}var nameOf2,init_link=__esm(
{"needlefit/viewer/page/link.js"(){"use strict";init_address();init_dom();init_inputs();init_steering();init_store();
nameOf2=({name,scene})=>name??scene.measured?.id??scene.title;press("copy-link",copy)}});var DEFINITIONS,define,init_definitions=__esm({"needlefit/viewer/page/definitions.js"(){"use strict";init_dom();
init_store();DEFINITIONS={depth:"Inserted arc length: how much of the needle is beyond the entry.","tip y":"Di\
stance of the tip from the entry axis, y; positive to the left of the entry.","tip slope":"Angle of the needle\
 at its tip against the entry axis.","steepest slope":"Largest slope dy/dx of the needle; the model takes it f\
or small.",roll:"Roll of the bevel from here on, about x: 0 turns the cut toward +y, 90 toward +z, ±180 toward\
 −y.","tip z":"Distance of the tip from the plane of the entry axis and y.","base y":"Lateral displacement o\
f the base of the needle, as it is set; positive to the left.","base slope":"Angle of the base of the needle a\
gainst the entry axis, as it is set.",guide:"Where a guide holds the needle: x along the entry, y to its left,\
 slope dy/dx as an angle.","noise floor":"The mean error that perfect parameters would still show if measureme\
nts err as stated."};listen("scene",({definitions,shape_parameters:shapes})=>{Object.assign(DEFINITIONS,definitions);
for(let{symbol,explanation}of shapes)DEFINITIONS[symbol]=`${explanation[0].toUpperCase()}${explanation.slice(1)}\
.`});define=(name,called=name)=>name in DEFINITIONS?element("span",{className:"term",title:DEFINITIONS[name]},
called):called}});function fillReadouts(list,readouts){let numbers=readouts.map(([name,unit])=>{let number2=element("span",{},"–");
return list.append(entry(define(name),[number2," ",element("small",{},unit)])),number2});return from=>readouts.
forEach(([,,read],i)=>write(numbers[i],from?read(from):"–"))}function inWords(){let{state,scene}=now;if(!state)
return"The needle has not been drawn yet.";let{tip,bevel,base,guides,errors}=state,held=guides.length===1?"1 g\
uide":`${guides.length} guides`,{symbol,value,digits:digits2,unit}=strengthOf(bevel),sentences=[`The needle is\
 ${state.depth_mm.toFixed(1)} mm deep, of ${scene.length_mm.toFixed(0)} mm.`,`Its tip is ${Math.abs(tip.lateral_mm).
toFixed(2)} mm to the ${tip.lateral_mm<0?"right":"left"}${tip.held?" and held there":""}, at ${angle(tip)}${tip.
z===null?"":`; z ${signed(tip.z,2)} mm`}.`,`The bevel turns the cut toward ${describeRoll(bevel)}, ${symbol} i\
s ${value.toFixed(digits2)} ${unit}.`,`The base stands at y ${signed(base.y,2)} mm, at ${angle(base)}; ${held}\
.`];if(exceeded(state)&&sentences.push(`The needle is ${exceeded(state)}.`),errors){let prediction=predictionOf(
state,scene);sentences.push(`${prediction?"The prediction against":"Against"} the measured needle ${comparedUpTo(
errors)}: ${listErrors(prediction?.errors??errors,scene.measured).join(", ")}.`)}return sentences.join(" ")}var NEEDLE,
TIP_Z,writeNeedle,writeErrors,comparedUpTo,exceeded,angle,init_readouts=__esm({"needlefit/viewer/page/readouts\
.js"(){"use strict";init_definitions();init_dom();init_quantities();init_store();init_view();NEEDLE=[["depth",
"mm",s2=>s2.depth_mm.toFixed(2)],["tip y","mm",s2=>signed(s2.tip.lateral_mm,2)],["tip z","mm",s2=>s2.tip.z===null?
"–":signed(s2.tip.z,2)],["tip slope","°",s2=>signed(toDegrees(s2.tip.rotation),2)],["steepest slope","",s2=>s2.
max_slope.toFixed(3)]],TIP_Z=NEEDLE.findIndex(([name])=>name==="tip z");writeNeedle=fillReadouts(part("readout\
s"),NEEDLE),writeErrors=_errors=>{},comparedUpTo=({whole,upto_mm:upto})=>whole?"over the whole insertion":`ove\
r the first ${upto.toFixed(1)} mm`;listen("scene",({measured})=>{if(part("compared").hidden=measured===null,!measured)
return;let metrics=measured.metrics.map(([name,label,unit])=>[label,unit,errors=>writeError(errors[name],unit)]);
for(let[,label,,text2]of measured.metrics)DEFINITIONS[label]=text2;part("errors").replaceChildren(),writeErrors=
fillReadouts(part("errors"),[...metrics,["noise floor","mm",({floor_mm:floor})=>writeError(floor,"mm")]])});exceeded=
({faults})=>faults.length?`outside the model: ${faults.join("; ")}`:"";listen("state",state=>{let{scene}=now;writeNeedle(
state),part("readouts").children[TIP_Z].hidden=!state.z;let follows=scene.plan&&!now.replay?.changed,title=part(
"title");title&&write(title,`${follows?"plan: ":isSteered(state,scene)?"steered by hand: ":""}${scene.title}`),
write("described",inWords());let words=exceeded(state);if(write("beyond",words&&`${words[0].toUpperCase()}${words.
slice(1)}. Its shape cannot be relied on.`),part("beyond").classList.toggle("low",toPy(state.tip.y)<view.box.top+
view.box.height/2),!scene.measured)return;let prediction=predictionOf(state,scene);writeErrors(state.errors&&{
...state.errors,...prediction?.errors}),write("against",`${prediction?"prediction ":""}against ${scene.measured.
id}${state.errors?`, ${comparedUpTo(state.errors)}`:""}`)});angle=({rotation})=>`${signed(toDegrees(rotation),
1)} degrees`}});function drawFigure(wide){let[across,tall]=sizeOf(part("picture")),{box,scale}=view,width=wide*PX_PER_MM,share=(width-
(across-box.width))/box.width,height=tall-box.height+share*box.height,above=isSpatial()?part("above").clientHeight:
0,style=getComputedStyle(document.documentElement),readLight=name=>style.getPropertyValue(`--${name}`).match(/#\w+/)?.[0]??
"";return look({scale:scale*share,box:{...box,width:share*box.width,height:share*box.height}},()=>writeFigure(
[width,height+above],wide,[now.scene.title,inWords()],readLight,()=>{above&&turned([0,height],0,()=>paintAbove(
[width,above])),paintPicture([width,height])}))}async function rasterize(svg,wide){let image=element("img",{src:`\
data:image/svg+xml,${encodeURIComponent(svg)}`});await image.decode();let width=Math.round(wide/25.4*DPI),height=Math.
round(width*image.height/image.width),canvas=element("canvas",{width,height});return canvas.getContext("2d")?.
drawImage(image,0,0,width,height),new Promise(resolve=>canvas.toBlob(blob=>resolve(blob??new Blob),"image/png"))}
var PX_PER_MM,DPI,init_figure=__esm({"needlefit/viewer/page/figure.js"(){"use strict";init_dom();init_drawing();
init_link();init_picture();init_readouts();init_sheet();init_store();init_view();PX_PER_MM=96/25.4,DPI=300;press(
"save-figure",async()=>{if(!now.state)return;let[format,wide]=[part("figure-format").value,Number(part("figure\
-width").value)],svg=drawFigure(wide);redraw();let name=format==="png"?save(await rasterize(svg,wide),"image/p\
ng",format):save(svg,"image/svg+xml",format);write("link-note",`Saved ${name}: the picture as it is shown.`)})}});function addField(into2,about,home,ask){let{name,symbol=name,unit,step,limits=[0,1],logarithmic,write:write2,read=Number}=about,
[to,from]=logarithmic?[one=>Math.log(Math.max(one,Number.MIN_VALUE)),Math.exp]:[Number,Number],[low,high]=limits.
map(to),field=template.content.firstElementChild?.cloneNode(!0),[number2,slider,mark,back]=["number","slider",
"mark","home"].map(kind=>field.querySelector(`.${kind}`)),[value,gesture2]=[NaN,newGesture()],share=one=>Math.
min(Math.max((to(one)-low)/(high-low),0),1),set=one=>{value=NaN,ask(one,{gesture:gesture2,below:field})},setAnew=one=>{
gesture2=newGesture(),set(one)};number2.setAttribute("aria-description",DEFINITIONS[symbol]),number2.ariaLabel=
slider.ariaLabel=name+(unit&&`, ${unit}`),number2.step=step,field.querySelector(".name")?.append(define(symbol,
name)),field.querySelector(".unit")?.append(unit),number2.addEventListener("change",()=>number2.value===""?show2(
value):setAnew(read(number2.value))),number2.addEventListener("keydown",event=>{ARROWS[event.key]&&(event.preventDefault(),
number2.stepUp(ARROWS[event.key]),(event.repeat?set:setAnew)(read(number2.value)))}),about.limits||slider.parentElement.
remove(),slider.max=STEPS,slider.addEventListener("input",()=>set(from(low+slider.value/STEPS*(high-low)))),slider.
addEventListener("change",()=>gesture2=newGesture()),back.hidden=mark.hidden=home===void 0,home!==void 0&&(back.
ariaLabel=`${number2.ariaLabel}: back to its initial value`,back.title=`back to ${write2(home)} ${unit}`.trim(),
mark.style.left=`calc(${THUMB/2}px + ${share(home)} * (100% - ${THUMB}px))`,press(back,()=>setAnew(home))),into2.
append(field);function show2(one){value=one,number2.value=write2(value),slider.value=Math.round(STEPS*share(value)),
slider.ariaValueText=`${write2(value)} ${unit}`.trim(),back.disabled=home!==void 0&&write2(home)===write2(value)}
return one=>{one!==value&&show2(one)}}var template,STEPS,THUMB,ARROWS,init_fields=__esm({"needlefit/viewer/pag\
e/fields.js"(){"use strict";init_definitions();init_dom();init_steering();template=part("field-template"),STEPS=
1e3,THUMB=16,ARROWS={ArrowUp:1,ArrowDown:-1}}});function buildFields({scene,recording}){shown=[];for(let id of["insertion-fields","guide-fields","tissue-field\
s","shape-fields"])part(id).replaceChildren();let{limits,fitted,simulation,layer_names:names,shape_parameters:shapes}=scene,
{steps:[{inputs:first}],law}=simulation,add2=(into2,input,item,about,read,home)=>{let[toField,fromField]=input.
endsWith("slope")?[degrees,slope]:[Number,Number],show2=addField(part(into2),about,home&&toField(home),(value2,how)=>change(
[[input,item,fromField(value2)]],how));shown.push(()=>show2(toField(read(now.state))))},addInput=(input,about,read,home)=>add2(
"insertion-fields",input,null,{...about,symbol:about.name},read,recording?void 0:home);addInput("depth_mm",{...MM,
name:"depth",step:1,write:digits(1),limits:[0,limits.depth_mm-.01]},s2=>s2.depth_mm,scene.depth_mm),addInput("\
base_y_mm",{...MM,name:"base y",limits:[-10,10]},s2=>s2.base.input_y,first.base.y),addInput("base_slope",{...TILT,
name:"base slope",limits:[-5,5]},s2=>s2.base.input_slope,first.base.slope),addInput("bevel_roll_deg",{name:"ro\
ll",unit:"°",step:10,limits:[-180,180],write:value2=>brief(value2,6)},s2=>s2.bevel.roll_deg,rollOf(first.bevel)),
first.guides.forEach((guide,i)=>{let item=i+1,addGuide=(axis,about)=>add2("guide-fields",`guide_${axis}${axis===
"slope"?"":"_mm"}`,item,{...about,name:`guide ${shortName({item,name:guide.name})}, ${axis}`,symbol:"guide"},s2=>(s2.
guides.find(one=>one.item===item)??guide)[axis]??0,recording?void 0:guide[axis]??0);addGuide("x",{...MM,name:""}),
addGuide("y",{...MM,name:"",write:digits(3)}),guide.slope!==null&&addGuide("slope",{...TILT,name:""})}),part("\
guide-part").hidden=!first.guides.length;let{symbol,unit,digits:count2,step,here,throughout,value}=strengthOf(
fitted);if(!recording?.some(([,changes])=>changes.some(([name])=>name===here))){let about={name:symbol,symbol,
unit,step,write:digits(count2),limits:limits[symbol==="b"?"offset_mm":"cut_angle_deg"]};add2("tissue-fields",throughout,
null,about,s2=>strengthOf(s2.bevel).value,value)}part("shape-part").hidden=!law.terms||!shapes.length,fitted.layers.
forEach((layer,i)=>{let called=names[i]||`layer ${i+1}`,about={...modulusLike(layer.mu_pa),name:`μ ${called}`,
symbol:"μ",logarithmic:!0,limits:limits.mu_pa};add2("tissue-fields","mu_pa",i+1,about,s2=>s2.layers[i].mu_pa,
layer.mu_pa);for(let{name,symbol:symbol2,unit:unit2}of law.terms?shapes:[]){let[low,high]=limits[name];add2("s\
hape-fields",name,i+1,{name:`${symbol2} ${called}`,symbol:symbol2,unit:unit2,step:Math.min(.1,(high-low)/100),
write:digits(2),limits:[low,high]},s2=>s2.layers[i][name],layer[name])}})}function refresh(){for(let show2 of shown)
show2();part("side").textContent=describeRoll(now.state.bevel)}var digits,shown,MM,TILT,init_inputs2=__esm({"n\
eedlefit/viewer/page/inputs.js"(){"use strict";init_dom();init_fields();init_bevel();init_quantities();init_steering();
init_store();digits=count2=>value=>value.toFixed(count2),shown=[],MM={unit:"mm",step:.1,write:digits(2)},TILT=
{unit:"°",step:.1,write:digits(2)};for(let kind of["state","unchanged"])listen(kind,refresh)}});function pin(){let{x:x2,y:y2,z}=now.state;setPinned(now.pinned?null:{x:x2,y:y2,z})}function setPinned(pinned){
now.pinned=pinned,part("pin").ariaPressed=String(!!pinned),write("pin",pinned?"Unpin":"Pin");let{measured,draws,
plan}=now.scene,there={measured,errors:measured,band:draws,plan,pinned,points:!0,path:!0,load:!0,inset:!0};NAMES.
forEach((name,i)=>chips[i].hidden=!there[name]),redraw()}var CHIPS,NAMES,fits,chips,init_toolbar=__esm({"needl\
efit/viewer/page/toolbar.js"(){"use strict";init_dom();init_store();init_view();CHIPS={measured:["measured"],errors:[
"errors","Gaps at the tip (TE) and along the shaft (IPE)"],band:["95 % band","95 % of the needles lie wholly i\
nside"],plan:["plan"],pinned:["pinned"],points:["constraint points","What holds the needle in the tissue: poin\
ts of the model, not data"],path:["tip path","Where the tip was at each depth"],load:["load","Lateral load of \
the tissue on the shaft, within the limits of the model"],inset:["true scale","The needle in a corner, with y \
as large as x"]},NAMES=Object.keys(CHIPS),fits=document.querySelectorAll("[data-fit]"),chips=NAMES.map(name=>{
let[called,title=""]=CHIPS[name],swatch=element("i",{ariaHidden:"true",className:`swatch ${name}`}),chip=element(
"button",{type:"button",title,ariaPressed:String(now.shown[name])},swatch,called);return chip.dataset.show=name,
press(chip,()=>{now.shown[name]=!now.shown[name],chip.ariaPressed=String(now.shown[name]),redraw()}),chip});part(
"chips").append(...chips);press("pin",pin);for(let one of fits)press(one,()=>fit(one.dataset.fit));listen("sce\
ne",()=>setPinned(null));listen("redraw",()=>fits.forEach(one=>one.ariaPressed=String(one.dataset.fit===view.fit)))}});function insert2(mm){let{session:{depth},scene}=now.steered,end=Math.max(Math.min(now.steered.reach(),scene.limits.
depth_mm),depth);go(["depth_mm",null,Math.min(Math.max(depth+mm,0),end)])}function hear(event){if(!now.state||
event.altKey)return;let key=event.key.length===1?event.key.toLowerCase():event.key,act=event.ctrlKey||event.metaKey?
COMMANDS[key]:KEYS.find(([keys])=>keys.includes(key))?.[3];act&&(event.preventDefault(),event.repeat||(gesture=
newGesture()),act(event))}var ROLL,gesture,go,flip,roll,moveBase,KEYS,COMMANDS,init_keyboard=__esm({"needlefit\
/viewer/page/keyboard.js"(){"use strict";init_dom();init_bevel();init_steering();init_store();init_toolbar();init_view();
ROLL=10,gesture=0,go=input=>change([input],{gesture});flip=()=>change([turnOver(now.state.bevel.roll_deg)]),roll=
by=>go(["bevel_roll_deg",null,wrap(now.state.bevel.roll_deg+by)]),moveBase=mm=>go(["base_y_mm",null,now.state.
base.input_y+mm]),KEYS=[[["ArrowRight"],"→","insert 1 mm; with Shift 0.1 mm",e=>insert2(e.shiftKey?.1:1)],[[
"ArrowLeft"],"←","retract, likewise",e=>insert2(e.shiftKey?-.1:-1)],[["ArrowUp"],"↑","base up by 0.1 mm; w\
ith Shift by 1 mm",e=>moveBase(e.shiftKey?1:.1)],[["ArrowDown"],"↓","base down, likewise",e=>moveBase(e.shiftKey?
-1:-.1)],[["f"],"F","flip the bevel",flip],[["r"],"R",`roll the bevel by ${ROLL}°; with Shift back`,e=>roll(e.
shiftKey?-ROLL:ROLL)],[["k"],"K","pin this needle to compare with, or unpin",pin],[["+","="],"+","zoom in; a d\
rag shifts, a double click shows the tissue",()=>zoom(1.25)],[["-"],"−","zoom out",()=>zoom(.8)],[["1"],"1",
"show the whole needle",()=>fit("whole")],[["2"],"2","show the tissue",()=>fit("tissue")],[["3"],"3","follow t\
he tip",()=>fit("tip")]],COMMANDS={z:event=>event.shiftKey?redo():undo(),y:()=>redo()};for(let[written3,what]of[
...KEYS.map(([,key,effect])=>[key,effect]),["Ctrl+Z, Y","undo, redo"]])part("key-list").append(entry(element("\
kbd",{},written3),what));part("picture").addEventListener("keydown",hear);press("undo",undo);press("redo",redo);
press("flip",flip)}});function goBack(){write("link-note",""),part("back").disabled=!0,now.replay?showPlace(now.replay,now.replay.places.
at(-1)??0):goHome()}function showPlace(replay,place){let{places,unit}=replay,end=places.at(-1)??0;forgetPast(),
replay.to(places.filter(one=>one<=place).length),scrub.value=String(place>=end?scrub.max:place),scrub.ariaValueText=
`${place.toFixed(1)} ${unit}`,write("time",`${place.toFixed(1)} of ${end.toFixed(1)} ${unit}`),show()}function openRecording(recording,planned=!1){
if(part("transport").hidden=!recording,now.replay=null,!recording)return;let places=recording.map(([time,changes])=>planned?
changes.find(([name])=>name==="depth_mm")?.[2]??0:time);now.replay=new Replay(now.steered,recording,places,planned?
"mm of the plan":"s of the recording"),scrub.max=String(Math.ceil(10*(places.at(-1)??0))/10),scrub.ariaLabel=planned?
"depth along the plan, mm":"time of the recording, s"}function readRecording(text2){let lines=text2.split(/\r?\n/),
count2=lines.findIndex(one=>!one.startsWith("#")),number2=now.data.needles.findIndex(({head})=>head&&identify(
head)===identify(text2));if(count2<1||lines[count2]!==COLUMNS)throw new ModelError("the file is no recording",
"a file of Save recording, or of needlefit plan");if(number2<0)throw new ModelError("the recording is of anoth\
er scene","one of this page; needlefit view --recording opens others");let steps2=[];for(let row of lines.slice(
count2+1).filter(Boolean)){let[step,time,name,item,value,tip]=row.split(",");Number(step)>steps2.length&&steps2.
push([Number(time),[],NaN]);let last3=steps2[steps2.length-1];last3[1].push([name,item?Number(item):null,Number(
value)]),tip&&(last3[2]=Number(tip))}return{number:number2,steps:steps2}}function openDropped(choose2){addEventListener(
"dragover",event=>event.preventDefault()),addEventListener("drop",async event=>{event.preventDefault();let[file]=event.
dataTransfer?.files??[];if(file)try{let{number:number2,steps:steps2}=readRecording(await file.text());await choose2(
number2),openRecording(steps2),goBack(),write("link-note",`Opened ${file.name}.`)}catch(error){refuse(error,part(
"proof").parentElement)}})}function keep(){let{needle,steered}=now,text2=JSON.stringify({head:needle.head,way:steered.
listWay().map(({changes})=>changes)});try{text2.length<=MOST_KEPT&&localStorage.setItem(keyOf(needle),text2)}catch{}}
function restore(){let{needle,steered,replay}=now,kept=JSON.parse(localStorage.getItem(keyOf(needle))??"null");
if(!kept||kept.head!==needle.head)return!1;steered.rewind();try{for(let changes of kept.way)steered.apply(changes)}catch{
return localStorage.removeItem(keyOf(needle)),goBack(),!1}return replay&&(replay.changed=!0),part("back").disabled=
!1,write("link-note","The needle as you left it: this browser keeps it."),show(),!0}var PAUSE,MOST_KEPT,scrub,
COLUMNS,identify,keyOf,keeping,init_recording=__esm({"needlefit/viewer/page/recording.js"(){"use strict";init_address();
init_dom();init_link();init_inputs();init_steering();init_store();init_stored();PAUSE=400,MOST_KEPT=1e6,scrub=
part("scrub"),COLUMNS="step,time_s,input,item,value,tip_lateral_mm";scrub.addEventListener("input",()=>{let{replay}=now;
replay&&showPlace(replay,Math.min(Number(scrub.value),replay.places.at(-1)??0))});press("back",()=>{localStorage.
removeItem(keyOf(now.needle)),goBack()});listen("steers",()=>{now.replay&&(now.replay.changed=!0)});press("sav\
e-recording",()=>{let name=save(writeRecording(now.needle.head??"",now.steered),"text/csv","csv");write("link-\
note",`Saved ${name}. It opens on this page, and with: needlefit view --recording ${name}`)});identify=head=>head.
split(`
`).filter(one=>one.startsWith("#")).slice(1).filter(one=>!one.startsWith("# needlefit =")).join(`
`);keyOf=needle=>`needlefit ${location.pathname} ${nameOf2(needle)}`,keeping=0;listen("steers",()=>{clearTimeout(
keeping),keeping=setTimeout(keep,PAUSE)});addEventListener("pagehide",()=>keeping&&keep())}});var main_exports={};async function choose(number2){let{data}=now;part("needle-choice").value=number2;let steered=await SteeredNeedle.
begin(data.kernel,data.needles[number2].scene);if(Number(part("needle-choice").value)!==number2)return;let needle=data.
needles[number2];Object.assign(now,{needle,steered,band:null});let{scene}=needle;openRecording(needle.recording,
!!needle.scene.plan),take("scene",scene),buildFields(needle);let specimen=needle.new_specimen?" (of a specimen\
 that was not fitted)":"",draws=counted(scene.draws?.sets??0,"posterior draw");write("band-note",scene.draws?`\
Band: 95 % of the needles of ${draws}${specimen} lie wholly in it. Noise and model error are not included.`:""),
part("origin-mark")&&write("origin-mark",scene.origin_mark),goBack()}async function stateAgreement(){let{data}=now,
{count:count2,largest}=await prove(data,SAME),[what,of]=data.needles[0].recording?["recorded state","recording"]:
["needle",data.title?"report":"program"],[agrees,place]=[largest<SAME,part("proof")],found=largest===0?`the sa\
me bytes as in the ${of}`:`up to ${largest.toExponential(1)} mm from the ${of}`;place.className=`quiet ${agrees?
"good":"bad"}`,place.dataset.count=count2,place.dataset.largest=largest;let checked=`Self-check ${agrees?"pass\
ed":"failed"}: ${counted(count2,what)} computed here`;write("proof",`${checked}, ${Number.isNaN(largest)?"one \
without a result":found} (needlefit ${data.needlefit}).`)}async function start(){let data=now.data=await load(),
script=new Blob([part("program").textContent],{type:"text/javascript"});computeBands(new Worker(URL.createObjectURL(
script)));let choice=part("needle-choice");choice.append(...data.needles.map((one,i)=>element("option",{value:String(
i)},[nameOf2(one),one.group].filter(Boolean).join(", ")))),part("choosing").hidden=data.needles.length<2,choice.
addEventListener("change",()=>choose(Number(choice.value))),addEventListener("hashchange",()=>followAddress(choose)),
openDropped(choose),await choose(0),await followAddress(choose)||restore(),await stateAgreement()}var init_main=__esm(
{"needlefit/viewer/page/main.js"(){"use strict";init_address();init_bands();init_dom();init_figure();init_inputs2();
init_keyboard();init_link();init_steered();init_quantities();init_recording();init_store();init_stored();start().
catch(error=>{throw write("proof",`The needle was not computed: ${error.message}`),part("proof").classList.add(
"bad"),error})}});typeof document>"u"?Promise.resolve().then(()=>(init_band_worker(),band_worker_exports)):Promise.resolve().then(()=>(init_main(),main_exports));})();
